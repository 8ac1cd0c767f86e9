"""Choose the step, basis and parts of a compressed file. These modules may change, as any decoder reads the result.

`components` computes the basis, also of parts, `trial` compresses with one step, `search` finds the step,
`inbetweens` codes the motion between frames, `uvs` codes UVs.
"""
