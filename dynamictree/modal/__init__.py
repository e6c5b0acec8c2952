"""The spectrum as a modal basis: response of the tree to forces."""
