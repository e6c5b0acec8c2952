"""The commands of `dynamictree`, one module each."""
