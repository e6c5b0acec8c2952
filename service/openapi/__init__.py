"""The OpenAPI document: additions to FastAPI's, examples, and the writer of the committed file."""
