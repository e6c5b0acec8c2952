"""Interaction with a tree: trees in memory, forces and streams."""
