"""The motion of one mesh on another: deformation transfer.

`transfer` is the way in: `sources` gets hold of the motion and its shape at rest, `making` prepares one of two methods.
`gradients` moves triangles as those of the source, and pieces by their `bridges`; `mixed` carries parts (`carried`),
puts them where they meet (`meetings`, `linkage`, `pivots`), and changes `joints`. Both take the `alignment` of the two
meshes. `planting` keeps named vertices from sliding: `contacts` finds when they are at rest
(`stance`), moves the body (`footing`), then turns `limbs` (`reach`). `report` measures what came of it (`coverage`,
`expected`, `acceleration`).
"""
