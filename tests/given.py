"""What readers of the documentation bring along: the files and names that its pages speak of and do not make.

All are small: bars that bend stand for characters.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import mixseq
from mixseq.sequence.sequence import MeshSequence
from tests.formats.gltf_files import write_glb
from tests.meshes import bending, bent, tube

CUT = '[[edit]]\noperation = "cut"\nstart = 0.5\nend = 1.0\n'


def walk(frames: int = 25, sides: int = 5, rings: int = 15) -> MeshSequence:
    """A bar that bends for a second, 24 frames per second."""
    mesh = tube(sides, rings)
    return MeshSequence.from_arrays(bending(mesh, frames), mesh[1], fps=24, name="walk")


@cache
def fitted(tolerance: float | None = None) -> mixseq.Model:
    """A model of the bar, which pages share."""
    return mixseq.fit(walk()) if tolerance is None else mixseq.fit(walk(), tolerance=tolerance)


def horse() -> MeshSequence:
    """The bar at rest, in other triangles."""
    return walk(1, sides=7, rings=19)


def rising() -> MeshSequence:
    """The bar lying on the ground, whose far end rises."""
    points, faces = tube(5, 15)
    poses = np.stack([bent(points, angle) for angle in np.linspace(0, -1, 5)])
    return MeshSequence.from_arrays(poses, faces, fps=24, name="rising")


def taller(sequence: MeshSequence) -> MeshSequence:
    """The first frame of a sequence, longer."""
    return MeshSequence.from_arrays(sequence.points[:1] * [1, 1.3, 1], sequence.faces)


def pairs() -> Iterator[str]:
    """Lines of a file of markers of the bar and the horse: vertices that are near each other."""
    ours, theirs = walk(2).points[0], horse().points[0]
    for vertex in range(0, len(ours), 2):
        distances = np.linalg.norm(theirs - ours[vertex], axis=1)
        if distances.min() < 0.1:
            yield f"{vertex} {distances.argmin()}"


def soles() -> list[int]:
    """Vertices of the horse on which its near end lies."""
    points = horse().points[0]
    return np.flatnonzero((points[:, 1] < -0.4) & (points[:, 2] < 1)).tolist()


def animated(*names: str) -> Callable[[Path], None]:
    """Return what writes a glTF file with animations of these names."""

    def make(path: Path) -> None:
        mixseq.write(path, rising())
        document, buffer = chunks(path)
        document["animations"] = [document["animations"][0] | {"name": name} for name in names]
        write_glb(path, document, buffer)

    return make


def chunks(path: Path) -> tuple[dict[str, Any], bytes]:
    """Return what a binary glTF file consists of."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def skinned(path: Path) -> None:
    """Write a bar with a skeleton of two bones."""
    mixseq.write_rig(path, mixseq.fit_skin(walk(5), bones=2))


def painted(path: Path) -> None:
    """Write a PLY file of the bar whose faces have one of two colours."""
    mesh = walk(1)
    points = "".join("{:.9g} {:.9g} {:.9g}\n".format(*point) for point in mesh.points[0])
    upper = mesh.points[0, :, 2][mesh.faces].mean(axis=1) > 2
    colours = np.where(upper[:, None], [255, 0, 0], [0, 0, 255])
    faces = "".join(
        "3 {} {} {} {} {} {}\n".format(*face, *colour) for face, colour in zip(mesh.faces, colours, strict=True)
    )
    path.write_text(
        f"ply\nformat ascii 1.0\nelement vertex {mesh.vertex_count}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(mesh.faces)}\nproperty list uchar int vertex_indices\n"
        f"property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n{points}{faces}"
    )


def moving(path: Path) -> None:
    """Write the bar in any format."""
    mixseq.write(path, walk())


def model(path: Path) -> None:
    """Write a model of the bar."""
    mixseq.save(path, fitted(0.002))


def text(content: str) -> Callable[[Path], None]:
    """Return what writes a text."""

    def make(path: Path) -> None:
        path.write_text(content, encoding="utf-8")

    return make


FILES: dict[str, Callable[[Path], None]] = {
    "attack.toml": text(CUT),
    "character.glb": skinned,
    "decoded.usdc": moving,
    "edits.toml": text(CUT),
    "feet.json": lambda path: text(json.dumps({"foot": soles()}))(path),
    "Horse.glb": lambda path: mixseq.write(path, horse()),
    "Wolf.glb": animated("Gallop", "Walk"),
    "horse.glb": lambda path: mixseq.write(path, horse()),
    "man.glb": skinned,
    "painted.ply": painted,
    "pairs.txt": lambda path: text("\n".join(pairs()))(path),
    "ramp.csv": text("0, 0\n0.5, 0.5\n1.5, 0.6\n"),
    "robot.glb": animated("Idle", "Dance"),
    "run.h5": model,
    "tall.obj": lambda path: mixseq.write(path, taller(walk())),
    "walk.h5": model,
    "wolf.glb": animated("Gallop", "Walk"),
    "wolf_horse.txt": lambda path: text("\n".join(pairs()))(path),
}
"""How a file is made, where it is not simply the bar in the format that the name tells."""


def make(name: str) -> None:
    """Make a file in the current folder."""
    path = Path(name)
    path.parent.mkdir(exist_ok=True)
    FILES.get(name, moving)(path)


def names() -> dict[str, Any]:
    """What parts of programs take as given: a sequence, its times and its model, and three poses."""
    sequence = walk()
    poses = MeshSequence.from_arrays(sequence.points[[0, 12, 24]], sequence.faces)
    given = {"walk": sequence, "times": sequence.times, "model": fitted(), "poses": poses}
    return {"mixseq": mixseq, "np": np, **given}
