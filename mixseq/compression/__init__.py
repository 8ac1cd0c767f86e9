"""Compress mesh sequences with guaranteed error bounds."""
