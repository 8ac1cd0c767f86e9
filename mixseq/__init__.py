"""mixseq."""
