"""The commands `serve` and `keys`: the whole service on one machine."""
