"""Transfer the motion of one mesh to another: deformation transfer.

`transfer` is the way in: `sources` reads the motion and its shape at rest, `alignment` how the target stands to it.
There are two methods. `gradient_transfer` moves triangles as those of the source, and pieces by their `attachments`.
`mixed_transfer` cuts the target into parts as the source is cut (`part_correspondence`), puts them together at their
`pivots`, carries over how joints bend (`joint_changes`), and solves for these (`joint_solver`, on `solved_joints`).
`planting` keeps named vertices from sliding: `footskate` finds when they are at rest (`stance`), moves the body
(`footing`), then the limbs of the `articulated_body` (`inverse_kinematics`). `report` says how good the result is
(`transfer_measures`, `coverage`).
"""
