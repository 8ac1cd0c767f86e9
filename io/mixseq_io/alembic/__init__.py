"""Alembic caches (.abc) in Ogawa files.

`samples` accesses Alembic's Python binding, and evaluates samples and transforms; `reader` and `writer` use it, and
`overlay` copies an original with new points.
"""
