"""Example and documentation scripts, which the tests run."""
