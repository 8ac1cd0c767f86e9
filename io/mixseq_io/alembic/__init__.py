"""Alembic caches (.abc) in Ogawa files.

`library`: access to the binding; `samples`: times, transforms and paths; `reader`; `writer`; `overlay`: meshes of a
written archive, alone or in a copy of the original.
"""
