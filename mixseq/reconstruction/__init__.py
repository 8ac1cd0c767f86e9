"""From points of a shape space back to vertex positions."""
