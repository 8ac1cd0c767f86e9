"""Compressed models as files have them, of whatever kind these are: a text, and streams of bytes with an index."""
