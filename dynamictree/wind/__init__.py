"""Wind: turbulent air, and flutter of leaves."""
