"""The OpenAPI document: additions to FastAPI's, examples, and the command that prints the committed file."""
