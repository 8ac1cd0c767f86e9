"""Ways to damage files. Each is a function of a `Case` that changes files in its folder and returns what it did."""
