"""Labels of faces that others made: found in files (`reading`), derived (`from_markings`), and written (`writing`)."""
