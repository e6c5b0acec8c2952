"""Response of a tree to forces, with its spectrum as the modal basis."""
