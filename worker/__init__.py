"""The side that computes: Celery tasks, the stages of a job, the housekeeper."""
