"""Compress mesh sequences with guaranteed error bounds.

`bitstream` decodes files and codes their contents, `encoder` chooses what is coded, `numbering` the order of vertices.
"""
