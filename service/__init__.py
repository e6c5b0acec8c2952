"""The HTTP API. Without torch."""
