"""Files that show a motion: one table of products (`table.py`), and a module of writers for each kind."""
