"""Compress mesh sequences with guaranteed error bounds.

`bitstream` codes and decodes streams, `encoder` chooses basis and step, `numbering` the order of vertices and faces.
"""
