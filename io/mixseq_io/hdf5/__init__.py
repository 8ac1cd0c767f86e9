"""Sequences and models of mixseq in HDF5.

`contents`, `inspection`: reading in a worker; `datasets`: arrays and settings; `sequences`, `models`, `coded_files`:
the kinds of files.
"""
