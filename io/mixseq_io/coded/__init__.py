"""Compressed models in files of any kind: a text, and streams of bytes with an index."""
