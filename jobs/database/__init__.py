"""Tables, their migrations, and how to connect to them."""
