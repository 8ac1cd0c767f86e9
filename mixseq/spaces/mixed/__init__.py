"""The mixed shape space S_m: parts have rest-space vertices and poses, joints have lengths and angles.

`mixed_space` defines the space, `construction` makes it. Vertices follow from `skinning_weights`, part poses and their
`articulation` (`posing_kernels`). `joint_projection` and `assembly` project, `pose_interpolation` interpolates in time.
"""
