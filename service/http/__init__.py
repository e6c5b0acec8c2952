"""HTTP layer: problem details, authentication, rate limits, conditional requests, multipart, timeouts."""
