"""4DTree: a generator of animated trees; each tree and its motion follow from a seed."""
