"""Scripts that show the whole way, run by the tests."""
