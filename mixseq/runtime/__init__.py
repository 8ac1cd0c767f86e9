"""How code runs: compiled loops, threads and clusters, lazy imports, interrupts, progress, types of arguments."""
