"""Stored bytes and the records that refer to them: artifacts, assets, uploads, backups."""
