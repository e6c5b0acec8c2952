"""Training of the shipped model, `small`."""
