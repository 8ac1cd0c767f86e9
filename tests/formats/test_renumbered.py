"""Models whose vertices have other numbers are laid over their originals, where these have their own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.compression.numbering import object_vertex_counts, walk_numbering
from mixseq.errors import OutputError
from mixseq.mesh.polygons import Polygons, match_polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.scene_meshes import split_meshes
from tests.compression.encoder.test_numbering import shuffled
from tests.meshes import bar

pytestmark = pytest.mark.slow


def pair() -> MeshSequence:
    """Two bending bars in no order, with texture coordinates, hard edges, and face sets."""
    one, other = shuffled(bar(6, 12, 4), 1), shuffled(bar(5, 9, 4), 2)
    faces = np.concatenate([one.faces, other.faces + one.vertex_count])
    points = np.concatenate([one.points, other.points + np.array([3, 0, 0])], axis=1)
    random = np.random.default_rng(0)
    corners, polygons = faces.size, len(faces)
    surface = Surface(
        uvs=CornerValues(random.integers(0, 9, (corners, 2)) / 8, np.arange(corners)),
        hard_edges=np.where(random.random(corners) < 0.1, np.arange(corners) + corners, faces.reshape(-1)),
        face_sets=(FaceSet("front", np.arange(0, polygons, 2)), FaceSet("back", np.arange(1, polygons, 2))),
        objects=(
            MeshObject("one", "", one.vertex_count, len(one.faces)),
            MeshObject("other", "", other.vertex_count, len(other.faces)),
        ),
    )
    sequence = MeshSequence.from_arrays(points, faces, times=one.times)
    return replace(sequence, surface=surface)


@pytest.mark.parametrize("kind", ["usdc", "abc", "glb"])
def test_decoded_over_the_original(kind: str, tmp_path: Path) -> None:
    """Everything but the points is as it was, number by number."""
    mixseq.write(tmp_path / f"original.{kind}", pair())
    original = mixseq.read(tmp_path / f"original.{kind}")
    coded = mixseq.compress(original, max_error=1e-3, order="free")
    assert coded.order == "free"
    mixseq.save(tmp_path / "free.h5", coded)
    mixseq.write(tmp_path / f"again.{kind}", mixseq.load(tmp_path / "free.h5").sample())
    again = mixseq.read(tmp_path / f"again.{kind}")
    found = mixseq.compare(original, again)
    assert 0 < found.max_error < 1.1e-3
    ours, theirs = original.surface, again.surface
    sets = [[(each.name, len(each.polygons)) for each in one.face_sets] for one in (ours, theirs)]
    assert sets[0] == sets[1]
    assert ours.uvs is not None and theirs.uvs is not None
    if kind != "glb":  # which tells vertices by their numbers in the model
        assert again.polygons.same_as(original.polygons)
        np.testing.assert_array_equal(theirs.uvs.at_corners, ours.uvs.at_corners)
        assert np.abs(again.points - original.points).max() < 0.01


def test_the_mesh_of_a_file_is_told_in_its_numbers() -> None:
    sequence = pair()
    walked = walk_numbering(sequence.polygons, object_vertex_counts(sequence), vertices=True)
    points = np.arange(sequence.vertex_count)[walked.vertices]
    before, after = split_meshes(sequence.header), split_meshes(walked.renumber_header(sequence.header))
    for was, new in zip(before, after, strict=True):
        ours = new.with_vertex_order_of(was.polygons)
        assert ours is not None
        assert match_polygons(ours.polygons, was.polygons) is not None
        assert points[ours.vertices].tolist() == list(range(was.vertices.start, was.vertices.stop))  # type: ignore[union-attr]
        assert was.with_vertex_order_of(was.polygons) is was
    assert before[0].with_vertex_order_of(before[1].polygons) is None


def test_another_mesh_is_refused(tmp_path: Path) -> None:
    sequence = pair()
    mixseq.write(tmp_path / "original.usdc", sequence)
    polygons = Polygons(sequence.polygons.counts, np.roll(sequence.polygons.indices.reshape(-1, 3), 1, 1).ravel())
    free = walk_numbering(polygons, object_vertex_counts(sequence), vertices=True).renumber_frames(
        replace(sequence, polygons=polygons)
    )
    assert isinstance(free, MeshSequence)
    mixseq.write(tmp_path / "same.usdc", free, onto=tmp_path / "original.usdc")  # corners begin elsewhere
    faces = sequence.faces.copy()
    faces[0] = faces[0][::-1]
    other = replace(sequence, polygons=Polygons.from_triangles(faces))
    with pytest.raises(OutputError, match="has no mesh with the faces of 'one'"):
        mixseq.write(tmp_path / "no.usdc", other, onto=tmp_path / "original.usdc")
