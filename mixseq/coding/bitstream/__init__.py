"""Decode compressed files, and code what they hold. Frozen: changing what a decoder computes breaks old files.

`mixseq.coding.encoder` decides what is written, and is free to change. Constants are part of the format unless they say
that they are free. Decoders find the same numbers on every machine: they decide by integers, and by float64
``+ - * /`` and roots in a fixed order.

Golden files: ``tests/coding/golden/*.npz`` (streams and what they decode to), and ``compressed-v1*`` in
``tests/formats/golden``. A meant change is a new version of the file format. Its specification is
``docs/file-format.md``, whose table of constants a test compares with these modules.
"""
