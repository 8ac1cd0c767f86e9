"""The motion of one mesh on another: deformation transfer."""
