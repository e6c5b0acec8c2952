"""How a tree answers a push: trees in memory, forces, streams."""
