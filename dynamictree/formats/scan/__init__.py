"""Point clouds of laser scanners and photogrammetry."""
