"""HTTP itself: problem details, authentication, rate limits, conditional requests, multipart, timeouts."""
