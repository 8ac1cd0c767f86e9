"""Which point of one mesh is which point of another."""
