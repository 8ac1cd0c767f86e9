"""Files of correspondences between two meshes: pairs of vertices (`markers`), and whole maps (`maps`)."""
