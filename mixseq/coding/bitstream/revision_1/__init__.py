"""Read the signals, part labels and residuals of model versions 4 and 7. Frozen: changing this breaks old files."""
