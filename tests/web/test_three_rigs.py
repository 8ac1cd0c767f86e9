"""three.js plays skins and morphs as Python shows them, at their frames and between."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import mixseq
from mixseq.rigging.rigs import Morph, Skeleton, Skin
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float
from mixseq_io.rig_files import measure_rig_file
from tests.formats.conftest import lossy
from tests.formats.gltf_files import validate
from tests.formats.rig_maker import carried, hinge, swelling
from tests.viewer.conftest import browser, keep, new_page, page
from tests.web.site import ADDRESS, serve, three
from tests.web.test_three import floats

if TYPE_CHECKING:
    from playwright.sync_api import Page

__all__ = ["browser", "keep", "new_page", "page"]  # fixtures

pytestmark = pytest.mark.slow

NEAR = 2e-6
"""Diagonals that positions may be off by: sums of float32."""

PLAY = """async (times) => {
  const { GLTFLoader } = await import("three/addons/loaders/GLTFLoader.js");
  const THREE = globalThis.THREE ?? await import("three");
  const { scene, animations } = await new GLTFLoader().loadAsync("rig.glb");
  const mixer = new THREE.AnimationMixer(scene), meshes = [], joints = [];
  animations.forEach((clip) => mixer.clipAction(clip).setLoop(THREE.LoopOnce).play());
  animations.forEach((clip) => { mixer.clipAction(clip).clampWhenFinished = true; });
  scene.traverse((thing) => thing.isMesh && meshes.push(thing));
  scene.traverse((thing) => thing.isBone && joints.push([thing.name, thing.parent.name]));
  const packed = ({ buffer }) => btoa(Array.from(new Uint8Array(buffer), (byte) => String.fromCharCode(byte)).join(""));
  const place = new THREE.Vector3(), more = new THREE.Vector3();
  const frames = times.map((time) => {
    mixer.setTime(time);
    scene.updateMatrixWorld(true);
    return meshes.map((mesh) => {
      const { position } = mesh.geometry.attributes, targets = mesh.geometry.morphAttributes.position ?? [];
      const points = new Float32Array(3 * position.count);
      for (let vertex = 0; vertex < position.count; vertex++) {
        place.fromBufferAttribute(position, vertex);
        targets.forEach((each, number) =>
          place.addScaledVector(more.fromBufferAttribute(each, vertex), mesh.morphTargetInfluences[number]));
        if (mesh.isSkinnedMesh) (mesh.applyBoneTransform ?? mesh.boneTransform).call(mesh, vertex, place);
        place.applyMatrix4(mesh.matrixWorld).toArray(points, 3 * vertex);
      }
      return packed(points);
    });
  });
  const vertices = meshes.map((mesh) => packed(new Float32Array(mesh.geometry.attributes._vertex.array)));
  return { frames, joints, vertices };
}"""
"""Skins by three.js's own function, morph targets by its influences; and which vertices of meshes were split into."""


def played(page: Page, file: Path, times: Float, kind: str = "trimesh") -> tuple[Float, list[list[str]]]:
    """Return the points ``(n, V, 3)`` of a file at some times, and its bones with their parents."""
    head, files = three(kind)
    serve(page, {**files, "rig.glb": file.read_bytes(), "index.html": f"<!doctype html><body>{head}"})
    page.goto(f"{ADDRESS}index.html")
    found = page.evaluate(PLAY, times.tolist())
    meshes = []
    for number, text in enumerate(found["vertices"]):
        split = np.array([floats(frame[number], 3) for frame in found["frames"]], dtype=np.float64)
        own = floats(text, 1).reshape(-1).astype(np.int64)
        meshes.append(split[:, np.unique(own, return_index=True)[1]])
        np.testing.assert_allclose(split, meshes[-1][:, own], rtol=0, atol=NEAR * np.ptp(split))
    return np.concatenate(meshes, axis=1), found["joints"]


def near(rig: Skin | Morph, shown: Float, times: Float) -> float:
    """Return how far points are from a rig at times, in diagonals."""
    expected = rig.resampled(times).points()
    return float(np.abs(shown - expected).max() / np.linalg.norm(np.ptp(expected[0], axis=0)))


@pytest.mark.parametrize("kind", ["trimesh", "npm"])
@pytest.mark.parametrize("name", ["hinge", "carried", "corrected", "swelling"])
def test_rigs_are_played_as_they_are(page: Page, tmp_path: Path, name: str, kind: str) -> None:
    rigs: dict[str, Skin | Morph] = {
        "hinge": hinge(),
        "carried": carried(hinge()),
        "corrected": hinge(targets=2),
        "swelling": swelling(),
    }
    rig = rigs[name]
    mixseq.write_rig(tmp_path / "rig.glb", rig)
    times = np.array([0, 0.04, 0.1, 0.15, 0.2, 0.26, 0.3])
    shown, joints = played(page, tmp_path / "rig.glb", times, kind)
    assert near(rig, shown, times) < NEAR
    assert joints == ([["lower", "skeleton"], ["upper", "lower"]] if isinstance(rig, Skin) else [])


@cache
def character(path: Path) -> tuple[MeshSequence, Skeleton, Skin]:
    """Read a character, and bind it to its own skeleton again."""
    with lossy():
        there = mixseq.read(path)
        skeleton, bind_pose = mixseq.read_skeleton(path), mixseq.read_bind_pose(path)
    return there, skeleton, mixseq.fit_skin(there, skeleton=skeleton, bind_pose=bind_pose, rounds=2)


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "kind"),
    [("gltf/KhronosFox.glb", "trimesh"), ("gltf/KhronosFox.glb", "npm"), ("usd/RiggedFigure.usdz", "trimesh")],
)
def test_a_character_on_its_own_skeleton(page: Page, tmp_path: Path, data: Path, name: str, kind: str) -> None:
    """Textured, with split vertices; bones keep names and parents, and the error is the one that is told."""
    there, skeleton, skin = character(data / name)
    mixseq.write_rig(tmp_path / "rig.glb", skin)
    shown, joints = played(page, tmp_path / "rig.glb", there.times, kind)
    assert near(skin, shown, there.times) < NEAR
    found = mixseq.compare(there, MeshSequence.from_header(there.header, shown))
    told = measure_rig_file(tmp_path / "rig.glb", there)
    assert found.max_error == pytest.approx(told.max_error, rel=1e-3)
    assert found.kg_percent == pytest.approx(told.kg_percent, rel=1e-3)
    above = [skeleton.names[parent] if parent >= 0 else "skeleton" for parent in skeleton.parents]
    assert dict(joints) == dict(zip(skeleton.names, above, strict=True))
    validate(tmp_path / "rig.glb")
