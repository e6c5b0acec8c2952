"""Conversion of uploaded bytes to assets: tus, multipart, URL ingest, archives, EXIF."""
