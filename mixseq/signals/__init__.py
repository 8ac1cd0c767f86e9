"""A sequence as time, pose and shape signals in a shape space.

`fitting` is `mixseq.fit`, `detail` chooses signals, `modes` are principal components; a `model` has a `curve` and a
`pose` map, and is decoded by `decoding`.
"""
