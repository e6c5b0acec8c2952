"""The HTTP side: a module a resource. Torch-free."""
