"""Geometry and topology of one triangle mesh."""
