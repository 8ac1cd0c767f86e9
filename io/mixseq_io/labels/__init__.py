"""Labels of faces that somebody else made: found in files (`reading`), derived (`given`), and written (`writing`)."""
