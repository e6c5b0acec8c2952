"""What of a source is plant and what stands still, which way is up, how large it is, and how many trees it holds."""
