"""Files that say what on one mesh is what on another: pairs of vertices (`markers`), and whole maps (`maps`)."""
