"""4DTree: trees that grow, and sway, from a seed."""
