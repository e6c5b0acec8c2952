"""The OpenAPI document: additions to FastAPI's, examples, and how the committed file is printed."""
