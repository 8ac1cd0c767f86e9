"""Alembic caches (.abc) in Ogawa files."""
