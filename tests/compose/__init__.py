"""`make compose`: docker-compose.yml on a real engine, from an empty folder to a restored backup."""
