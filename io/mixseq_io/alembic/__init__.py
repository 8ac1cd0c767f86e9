"""Alembic caches (.abc) in Ogawa files.

`library` accesses Alembic's Python binding, `samples` has times, transforms and paths, and `overlay` the meshes of a
written archive, new or in a copy of the original. `reader` and `writer` use these modules.
"""
