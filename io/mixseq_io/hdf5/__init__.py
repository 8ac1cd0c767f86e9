"""Read and write sequences and models of mixseq in HDF5.

`contents` and `inspection` read files in a worker; `datasets` stores arrays and settings. `sequences` and `models`
define the kinds of files, besides compressed models (`mixseq_io.coded`).
"""
