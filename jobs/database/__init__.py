"""Tables, how they are made, and how to connect to them."""
