"""What service and worker agree on: jobs, their store, their bytes, their settings. Torch-free, HTTP-free."""
