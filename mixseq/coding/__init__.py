"""Compression: signals as few bytes, with an error that is guaranteed."""
