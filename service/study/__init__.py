"""Blind comparison of films by people, as the paper's user study does it."""
