"""Transfer the motion of one mesh to another (deformation transfer; `transfer`).

Modules of the correspondence: `markers`, `suggestions`, `proposals`, `checks`, `registration`, `correspond`.
Modules of the motion: `sources`, `gradient_transfer` or `mixed_transfer` (with `parts`, `joints`, `limbs`, `contacts`).
"""
