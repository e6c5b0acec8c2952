"""The life of a job: its rows, a worker's changes, the housekeeper's, its log."""
