"""Save models and compressed sequences in files."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from mixseq.choices import STILLS, StillName
from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
from mixseq.errors import OutputError, SettingsError
from mixseq.runtime.public import public
from mixseq.signals.model import Model
from mixseq.types import PathLike
from mixseq.version import __version__
from mixseq_io.coded.packing import pack
from mixseq_io.coded.streams import Container
from mixseq_io.hdf5.contents import MODEL_FORMAT
from mixseq_io.hdf5.datasets import body_groups, create_h5
from mixseq_io.hdf5.models import write_model
from mixseq_io.loading import GLB_EXTENSION, MODEL_EXTENSIONS


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
    if target.suffix.lower() == GLB_EXTENSION:
        from mixseq_io.gltf.mesh_sequence import write_sequence

        if not isinstance(model, CompressedSequence):
            raise OutputError(
                f"{target}: a .glb holds compressed models; compress the sequence with mixseq.compress(sequence, "
                "max_error=1e-3), or mixseq encode --max-error"
            )
        write_sequence(target, model, still)
        return
    with create_h5(target) as (file, _):
        if isinstance(model, CompressedSequence):
            write_container(file, pack(model))
        else:
            write_model(file, model)


def write_container(file: h5py.File, container: Container) -> None:
    """Store the text of a compressed model as an attribute, and all streams as one dataset, as each takes bytes.

    Further bodies have groups. Strings have fixed length, since a string of variable length takes 4 KiB.
    """

    def write_text(group: h5py.Group, name: str, text: bytes) -> None:
        group.attrs.create(name, text, dtype=h5py.string_dtype("ascii", len(text)))

    write_text(file, "format", MODEL_FORMAT.encode())
    write_text(file, "created_by", f"mixseq {__version__}".encode())
    file.attrs["version"] = container.version
    groups = body_groups(file, len(container.bodies))
    for each, group in zip((container, *container.bodies), (file, *groups), strict=True):
        write_text(group, "coding", each.text)
        group.create_dataset("streams", data=np.frombuffer(each.streams, dtype=np.uint8), track_times=False)
