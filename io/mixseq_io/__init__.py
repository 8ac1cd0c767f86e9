"""File formats of mixseq."""
