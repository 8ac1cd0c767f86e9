"""The viewer in a browser: a viser server with meshes, controls and charts (the extra ``viewer``)."""
