"""Several trees in one file: individual trees found in points, and what belongs to each."""
