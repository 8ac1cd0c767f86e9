"""Pixar's Universal Scene Description."""
