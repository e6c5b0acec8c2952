"""Life cycle of a job: its rows, the changes by workers and by the housekeeper, statistics."""
