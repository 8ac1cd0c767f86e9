"""Code and decode the streams of compressed files. Frozen: changing what a decoder computes breaks old files.

Constants are part of the format unless marked as free. Decoders compute the same numbers on every machine: they use
only integers, and float64 ``+ - * /`` and roots in a fixed order.

Golden files: ``tests/compression/golden/*.npz`` (streams and their decoded values), and ``compressed-v1*`` in
``tests/formats/golden``. An intended change is a new version of the file format, specified in ``docs/file-format.md``,
whose table of constants a test compares with these modules.
"""
