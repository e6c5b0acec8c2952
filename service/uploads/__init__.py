"""From bytes that a client sends to an asset: tus, multipart, URL ingest, archives, EXIF."""
