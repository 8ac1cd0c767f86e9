"""Files of text and arrays about faces and vertices: labels of parts, markers, contacts and maps."""
