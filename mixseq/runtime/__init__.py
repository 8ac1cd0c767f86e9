"""Infrastructure: compiled loops, threads and clusters, lazy imports, interrupts, progress, checks of arguments."""
