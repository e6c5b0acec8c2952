"""Tables of the job store, their creation, and connections to the database."""
