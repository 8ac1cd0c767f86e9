"""Read and write files of mesh sequences, as a `mixseq.sequence.sequence.MeshSequence` or frame by frame.

A file's extension selects its format in the table `FORMATS`. pxr and h5py are imported only when a file needs them.

Examples
--------
>>> import tempfile
>>> import numpy as np
>>> from mixseq.sequence.sequence import MeshSequence
>>> points = np.zeros((2, 3, 3), dtype=np.float32)
>>> points[:, 1, 0] = points[:, 2, 1] = 1
>>> with tempfile.TemporaryDirectory() as folder:
...     write(folder + "/triangle.npz", MeshSequence.from_arrays(points, [[0, 1, 2]]))
...     read(folder + "/triangle.npz")
MeshSequence('mesh': 2 frames, 3 vertices, 1 faces, 24 fps)
"""

from mixseq_io.reader import SequenceReader, unzip_blocks
from mixseq_io.registry import FORMATS, open_sequence, read, write, write_blocks
from mixseq_io.rig_files import read_bind_pose, read_skeleton, write_rig
from mixseq_io.text.label_files import read_labels
from mixseq_io.text.labels import Labels

__all__ = [
    "FORMATS",
    "Labels",
    "SequenceReader",
    "open_sequence",
    "read",
    "read_bind_pose",
    "read_labels",
    "read_skeleton",
    "unzip_blocks",
    "write",
    "write_blocks",
    "write_rig",
]
