"""The spectrum as a modal basis: how the tree answers a push."""
