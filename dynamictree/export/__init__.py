"""Export of motions: one table of products (`table.py`), and one module of writers for each kind."""
