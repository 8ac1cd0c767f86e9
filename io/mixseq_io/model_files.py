"""Save and load models and compressed sequences, and open HDF5 and glTF files, which hold a sequence or a model.

Encoders and decoders are imported by the functions that need them.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mixseq.choices import STILLS, StillName
from mixseq.errors import FormatError, OutputError, SettingsError
from mixseq.runtime.public import public
from mixseq.types import FloatArray, IntArray, PathLike
from mixseq_io.files import check_memory, memory_limit
from mixseq_io.gltf.document import has_sequence
from mixseq_io.hdf5.contents import MODEL_FORMAT, parse_container, read_attributes, read_contents, translate_h5_errors
from mixseq_io.reader import SequenceReader
from mixseq_io.registry import HDF5_SIGNATURE

if TYPE_CHECKING:
    from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
    from mixseq.signals.model import Model
    from mixseq_io.coded.streams import Container

GLB_EXTENSION = ".glb"
MODEL_EXTENSIONS = (".h5", ".hdf5", GLB_EXTENSION)


def is_glb(path: Path) -> bool:
    """Whether a file name ends in ``.glb``."""
    return path.suffix.lower() == GLB_EXTENSION


def is_model(path: Path) -> bool:
    """Whether a file holds a model instead of a sequence."""
    if path.suffix.lower() not in MODEL_EXTENSIONS or not path.is_file():
        return False
    return has_sequence(path) if is_glb(path) else read_attributes(path).kind == MODEL_FORMAT


def is_compressed(path: Path) -> bool:
    """Whether a file holds a compressed model."""
    if is_glb(path):
        return has_sequence(path)
    file = read_attributes(path)
    return file.kind == MODEL_FORMAT and "coding" in file.attrs


def read_container(path: Path) -> Container:
    """Read the text and the streams of a compressed model without decoding them."""
    if is_glb(path):
        from mixseq_io.gltf import mesh_sequence

        return mesh_sequence.read_container(path)
    return parse_container(read_contents(path, MODEL_FORMAT))


def read_compressed(path: Path) -> CompressedSequence:
    """Read a compressed sequence, and verify its checksums."""
    from mixseq_io.coded.streams import read_sequence

    return read_sequence(path, read_container(path))


def compressed_sizes(path: Path) -> dict[str, int]:
    """Return the size in bytes of each part of a compressed model."""
    from mixseq_io.coded.streams import read_index
    from mixseq_io.gltf.mesh_sequence import overhead_size

    container = read_container(path)
    indices = [read_index(path, each) for each in (container, *container.bodies)]
    still = overhead_size(path) if is_glb(path) else 0

    def size_of(name: str) -> int:
        return sum(index.header[name].size for index in indices if name in index.header)

    total, connectivity = path.stat().st_size, size_of("connectivity")
    return {
        "total": total,
        "connectivity": connectivity,
        "still": still,
        "container": total - container.nbytes - still,
        "signals": container.nbytes - connectivity,
        "uvs": size_of("uvs"),
        "surface": size_of("surface"),
        "index": sum(index.size for index in indices),
    }


def model_or_reader(reader: SequenceReader) -> SequenceReader | Model:
    """Return the model of a reader with all its bodies, the reader itself if there is none, or other axes are read."""
    if not isinstance(reader, ModelReader):
        return reader
    axes, own_axes = (
        (each.up_axis, each.metres_per_unit, each.times[0]) for each in (reader.header, reader.model.header)
    )
    return reader.model if axes == own_axes else reader


@public
def save(path: PathLike, model: Model | CompressedSequence, *, still: StillName = "draco") -> None:
    """Store a model or a compressed sequence in an HDF5 file, or a compressed sequence in a GLB file.

    Parameters
    ----------
    path : path-like
        The output file; an existing file is replaced when the new file is complete.
    model : Model or CompressedSequence
        Model or compressed sequence to store. Models, also those loaded from compressed files, are stored as signals.
    still : {"draco", "plain", "none"}
        Form of the first frame in a .glb, for viewers that do not support mesh sequences: compressed by Draco (extra
        ``draco``), stored as float32 (5 to 10 times the bytes), or omitted.

    Raises
    ------
    OutputError
        If the file cannot be written, its extension is not .h5, .hdf5 or .glb, the shape space cannot be stored, or the
        extension is .glb and the model is not compressed.
    MissingExtraError
        If `still` needs Draco and it is not installed.
    SettingsError
        If `still` is not one of these names.

    Examples
    --------
    >>> import mixseq
    >>> mixseq.save("model.h5", mixseq.fit("arm.usdc"))
    """
    target = Path(path)
    if still not in STILLS:
        raise SettingsError(f"still is {still!r}; one of {', '.join(STILLS)} is expected")
    if target.suffix.lower() not in MODEL_EXTENSIONS:
        raise OutputError(f"{target}: models are HDF5 or GLB files; end the name in {' or '.join(MODEL_EXTENSIONS)}")
    from mixseq.compression.bitstream.compressed_sequence import CompressedSequence

    if is_glb(target):
        from mixseq_io.gltf.mesh_sequence import write_sequence

        if not isinstance(model, CompressedSequence):
            raise OutputError(
                f"{target}: a .glb holds compressed models; compress the sequence with mixseq.compress(sequence, "
                "max_error=1e-3), or mixseq encode --max-error"
            )
        write_sequence(target, model, still)
        return
    from mixseq_io.coded.packing import pack, write_container
    from mixseq_io.hdf5.datasets import create_h5
    from mixseq_io.hdf5.models import write_model

    with create_h5(target) as (file, _):
        if isinstance(model, CompressedSequence):
            write_container(file, pack(model))
        else:
            write_model(file, model)


@public
def load(path: PathLike, *, max_memory: float | None = None) -> Model:
    """Load a model from an HDF5 file, or from a GLB file with a mesh sequence.

    Parameters
    ----------
    path : path-like
        File written by `save`; signals in the file may have been edited.
    max_memory : float, optional
        Memory limit in bytes, as in `mixseq_io.open_sequence`.

    Returns
    -------
    Model

    Raises
    ------
    FormatError
        If the file is missing, damaged, not a model, or written by another version of mixseq, if it needs more than
        `max_memory`, or if its signals contradict each other.

    Examples
    --------
    >>> import mixseq
    >>> mixseq.load("arm.h5").sample(fps=40)
    MeshSequence('bar': 13 frames, 77 vertices, 150 faces, 40 fps)
    """
    with memory_limit(max_memory):
        source = Path(path)
        if not is_glb(source):
            return _load_h5(source)
        from mixseq_io.coded.streams import decode_model

        return decode_model(source, read_compressed(source))


def _load_h5(source: Path) -> Model:
    if source.is_file():
        with source.open("rb") as stream:
            signature = stream.read(len(HDF5_SIGNATURE))
        if signature not in (HDF5_SIGNATURE, b""):
            raise FormatError(f"{source} is not a model, which is an HDF5 or GLB file; make one with mixseq encode")
        check_memory(source, source.stat().st_size, "the file itself")
    # The decoder is imported meanwhile, which takes about the time that the worker needs to read the file.
    import_decoder = partial(import_module, "mixseq_io.coded.streams")
    file = read_contents(source, MODEL_FORMAT, meanwhile=import_decoder)
    if file.kind != MODEL_FORMAT:
        raise FormatError(
            f"{source} is an HDF5 file, but not a mixseq model (format = {file.kind!r}); make one with mixseq encode"
        )
    with translate_h5_errors(source):
        if "coding" in file.attrs:
            from mixseq_io.coded.streams import decode_model, read_sequence

            return decode_model(source, read_sequence(source, parse_container(file)))
        from mixseq_io.hdf5.models import read_model

        return read_model(file)


class ModelReader(SequenceReader):
    """Reader that decodes the frames of a `model` on demand; warns of further bodies when it does."""

    def __init__(self, path: Path) -> None:
        from mixseq.signals.decoding import FRAMES_PER_BLOCK

        self.model = load(path)
        self._max_block_frames = FRAMES_PER_BLOCK
        super().__init__(path, self.model.header)

    @property
    def parts(self) -> IntArray | None:
        """Part ``(F,)`` of every triangle; None if the model has none."""
        return self.model.parts

    def _read(self, quantity: str, size: int) -> Iterator[FloatArray]:
        return self.model.frames.blocks(min(size, self._max_block_frames))


def open_h5(path: Path) -> SequenceReader:
    """Open an HDF5 file with a sequence or a model."""
    contents = read_attributes(path)
    if contents.kind == MODEL_FORMAT:
        return ModelReader(path)
    from mixseq_io.hdf5.sequences import open_h5_sequence

    return open_h5_sequence(contents)


def open_gltf(path: Path, **options: Any) -> SequenceReader:
    """Open a glTF file with meshes or a compressed model."""
    if not is_model(path):
        from mixseq_io.gltf import reader

        return reader.open_gltf(path, **options)
    for name, value in options.items():
        if value is not None:
            raise SettingsError(f"{path} holds a compressed model, which has no {name} to choose; leave it out")
    return ModelReader(path)
