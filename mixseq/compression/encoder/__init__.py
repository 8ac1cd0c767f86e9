"""Choose step, basis and parts of a compressed file (`compress`). Free to change: any decoder reads the result.

`components` and `parts` make the basis, `trial` compresses with one step, `search` finds the step, `uvs` does textures.
"""
