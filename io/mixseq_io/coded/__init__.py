"""Read (`streams`) and write (`packing`) compressed models: a JSON text, and a dataset of byte streams."""
