"""Compressed models as a text and streams of bytes: `streams` holds the layout and reads it, `packing` writes it."""
