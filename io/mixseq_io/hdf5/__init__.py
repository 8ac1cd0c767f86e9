"""Our own files: sequences and models in HDF5."""
