"""Transfer the motion of one mesh to another (deformation transfer; `transfer`).

Correspondence: `markers`, `suggestions`, `checks`, `registration`, `matching`, all called by `correspond`.
Motion: `sources`, then `gradient_transfer` (triangles) or `mixed_transfer` (`parts`, `joints`, `limbs`, `contacts`).
"""
