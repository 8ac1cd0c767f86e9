"""Skins and morph targets fitted to sequences, for game engines."""
