"""One module per file format: the only place where files are read or written, and axes and units converted."""
