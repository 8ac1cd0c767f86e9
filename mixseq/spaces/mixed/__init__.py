"""The mixed shape space S_m: parts by their rest-space vertices and poses, joints by lengths and angles.

`mixed_space` is the space, `construction` makes it of a sequence. Vertices follow `skinning_weights`, part poses and
their `articulation` (`posing_kernels`); `joints` and `assembly` are its projections, `pose_interpolation` interpolates.
"""
