"""Segment individual trees in the points of one file."""
