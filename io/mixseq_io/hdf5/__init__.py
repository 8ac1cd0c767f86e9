"""Read and write sequences and models of mixseq in HDF5.

`contents` and `inspection` read files in a worker; `datasets` stores arrays and settings. `sequences`, `models` and
`coded_files` define the three kinds of files.
"""
