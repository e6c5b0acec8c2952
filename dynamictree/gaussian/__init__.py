"""Gaussian clouds: 3DGS primitives, their binding to a mesh, their motion and their rendering."""
