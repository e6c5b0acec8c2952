"""Worker: Celery tasks, the stages of a job, the housekeeper."""
