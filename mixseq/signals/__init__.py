"""Represent a sequence by time, pose and shape signals in a shape space.

`fitting` contains `mixseq.fit`, `detail` computes signals, and `pose` computes principal components. A `model`
consists of a `curve` and a `pose` map; `decoding` decodes it. `bodies` are other meshes that move by the same signals,
and `shape_exchange` makes them.
"""
