"""Choose step, basis and parts of a compressed file. Free to change: any decoder reads the result."""
