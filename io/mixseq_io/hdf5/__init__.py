"""Sequences and models of mixseq in HDF5."""
