"""The version of mixseq, defined only here."""

__version__ = "0.1.0"
