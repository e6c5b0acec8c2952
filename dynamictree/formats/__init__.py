"""One module a file format: the only place where files are read or written, and where axes and units are converted."""
