"""Files with compressed models: HDF5, and GLB with a mesh sequence."""

from __future__ import annotations

from pathlib import Path

from mixseq.coding.bitstream.compressed_sequence import CompressedSequence
from mixseq_io.coded.reading import sequence_of
from mixseq_io.coded.stream_index import Container, read_index
from mixseq_io.gltf import sequence_extension
from mixseq_io.hdf5 import coded_files
from mixseq_io.hdf5.contents import read_attributes, read_contents
from mixseq_io.hdf5.h5_files import MODEL_FORMAT


def is_compressed(path: Path) -> bool:
    """Whether a file has a compressed model."""
    if sequence_extension.is_glb(path):
        return sequence_extension.has_sequence(path)
    file = read_attributes(path)
    return file.kind == MODEL_FORMAT and "coding" in file.attrs


def read_container(path: Path) -> Container:
    """Read text and streams of a compressed model."""
    if sequence_extension.is_glb(path):
        return sequence_extension.read_container(path)
    return coded_files.container_of(path, read_contents(path, MODEL_FORMAT))


def read_compressed(path: Path) -> CompressedSequence:
    """Read a compressed sequence and check all its bytes."""
    return sequence_of(path, read_container(path))


def compressed_sizes(path: Path) -> dict[str, int]:
    """Return the sizes in bytes of a compressed model's parts."""
    container = read_container(path)
    index = read_index(path, container)
    still = sequence_extension.other_data(path) if sequence_extension.is_glb(path) else 0
    total, connectivity = path.stat().st_size, index.ground["connectivity"].size
    return {
        "total": total,
        "connectivity": connectivity,
        "still": still,
        "container": total - len(container.streams) - still,
        "signals": len(container.streams) - connectivity,
        "uvs": index.ground["uvs"].size if "uvs" in index.ground else 0,
        "surface": index.ground["surface"].size,
        "index": index.size,
    }
