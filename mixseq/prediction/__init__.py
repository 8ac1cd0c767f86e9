"""What lies between frames: weights of frames over time, and poses of parts that agree with their neighbours."""
