"""The commands `serve`, `doctor` and `keys`: the whole service on one machine."""
