"""Request and response bodies that are HTTP's own."""
