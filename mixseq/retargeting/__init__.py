"""Transfer the motion of one mesh to another: deformation transfer.

`transfer` is the entry point: `sources` reads the motion and its rest shape, `alignment` the pose of the target
relative to it. There are two methods. `gradient_transfer` moves triangles as those of the source, and pieces by their
`attachments`. `mixed_transfer` cuts the target into parts as the source (`part_correspondence`), assembles them at
their `pivots`, transfers changes of joints (`joint_changes`), and solves for these (`joint_solver`, `solved_joints`).
`planting` keeps named vertices from sliding: `footskate` finds when they rest (`stance`), moves the body (`footing`),
then the limbs of the `articulated_body` (`inverse_kinematics`). `report` measures the result (`transfer_measures`,
`coverage`).
"""
