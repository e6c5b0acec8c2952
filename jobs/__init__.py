"""Code that service and worker share: jobs, their store, files and settings. Without torch and HTTP."""
