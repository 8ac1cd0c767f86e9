"""Point caches without faces of their own: PC2 and MDD with a mesh beside them."""
