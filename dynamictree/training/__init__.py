"""Training of the small model and of the paper's, and what they are measured by."""
