"""Bytes and what refers to them: artifacts, assets, uploads, backups."""
