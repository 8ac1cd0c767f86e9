"""Labels of faces from other programs: read (`reading`), derived (`from_markings`), and written (`writing`)."""
