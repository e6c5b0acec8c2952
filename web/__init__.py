"""The viewer: what a browser gets at `/`. Plain ES modules, vendored libraries, example trees; no build step."""
