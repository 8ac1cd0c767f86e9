"""Transfer the motion of one mesh to another (deformation transfer).

Meshes are put into correspondence first: `markers` are pairs of vertices, `suggestions` proposes them, `checks`
refuses those that cannot be meant; `registration` deforms one mesh onto the other and `matching` reads closest points.
`transfer` then moves the target: by `mixed_transfer` (parts, pivots and joints) or `gradient_transfer` (triangles).
`contacts` keeps standing feet from sliding; `report` measures the result.
"""
