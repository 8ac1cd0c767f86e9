"""The contact sheet of a transfer: which way the target is seen, and which colours it has."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.pictures.sheets import common_parts, heading_degrees, transfer_sheet
from mixseq.retargeting.markers import Correspondence
from mixseq.retargeting.transfer import Transfer, TransferSettings, plan_transfer
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from tests.meshes import bar, rotation, tetrahedron
from tests.pictures.test_sheets import PAGE_PIXELS, png_size

pytestmark = pytest.mark.slow

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def body() -> MeshSequence:
    return bar(6, 9, frames=4)


def planned(source: MeshSequence, points: FloatArray, **settings: Any) -> Transfer:
    target = MeshSequence.from_arrays(points[None], source.faces)
    return plan_transfer(source, target, TransferSettings(**{"method": "gradients", **settings}))


def sheet(made: Transfer, frames: tuple[int, ...] = (1, 3)) -> bytes:
    file = io.BytesIO()
    points = np.concatenate(list(made.blocks()))
    transfer_sheet(file, made, frames, points[list(frames)])
    return file.getvalue()


@pytest.mark.parametrize("method", ["mixed", "gradients"])
def test_sheet_has_the_width_of_a_page_and_is_reproducible(body: MeshSequence, method: str) -> None:
    made = planned(body, body.points[0] * [1, 1.2, 1], method=method)
    first = sheet(made)
    assert png_size(first)[0] == PAGE_PIXELS
    assert first == sheet(made)


def test_more_columns_make_smaller_panels(body: MeshSequence) -> None:
    made = planned(body, body.points[0])
    assert png_size(sheet(made, (0, 1, 2, 3)))[1] < png_size(sheet(made, (0,)))[1]


def test_sheet_goes_to_a_path(body: MeshSequence, tmp_path: Path) -> None:
    made = planned(body, body.points[0])
    transfer_sheet(tmp_path / "sheet.png", made, [1], next(made.blocks())[1:2], title="bar")
    assert png_size((tmp_path / "sheet.png").read_bytes())[0] == PAGE_PIXELS


def test_of_a_turned_target_the_sheet_is_the_same_but_for_its_size(body: MeshSequence) -> None:
    one = planned(body, body.points[0].astype(np.float64))
    turned = planned(body, 2.0 * body.points[0] @ rotation((0, 0.8, 0)).T)
    assert png_size(sheet(one)) == png_size(sheet(turned))


@pytest.mark.parametrize("degrees", [0.0, 40.0, -130.0, 180.0])
def test_heading(body: MeshSequence, degrees: float) -> None:
    turn = rotation((0, np.radians(degrees), 0))
    made = planned(body, 3.0 * body.points[0] @ turn.T + [1, 2, 3])
    assert np.cos(np.radians(heading_degrees(made) - degrees)) == pytest.approx(1)


def test_points_of_another_mesh_or_too_few_are_refused(body: MeshSequence) -> None:
    made = planned(body, body.points[0])
    for points in (body.points[:1], body.points[:2, :5]):
        with pytest.raises(SettingsError, match="give a pose of the target for each frame"):
            transfer_sheet(io.BytesIO(), made, [0, 1], points)


@pytest.mark.parametrize("method", ["mixed", "gradients"])
def test_the_same_mesh_has_the_same_parts(body: MeshSequence, method: str) -> None:
    given = (body.points[0][body.faces].mean(axis=1)[:, 2] > 2).astype(np.int64)
    source, target = common_parts(planned(body, body.points[0], method=method, parts=given))
    np.testing.assert_array_equal(source, target)
    assert len(np.unique(source[given == 0])) == len(np.unique(source[given == 1])) == 1


def test_what_follows_has_the_colour_of_what_it_follows() -> None:
    points, faces = tetrahedron()
    source = MeshSequence.from_arrays(points[None], faces)
    target = MeshSequence.from_arrays(np.concatenate([points, points + 5])[None], np.concatenate([faces, faces + 4]))
    same = Correspondence.identity(4, 4)
    mapping = replace(
        same,
        target_size=(8, 8),
        corners=np.concatenate([same.corners, np.full((4, 3), -1)]),
        weights=np.concatenate([same.weights, np.zeros((4, 3))]),
        faces=np.append(same.faces, np.full(4, -1)),
        leaders=np.append(same.leaders, np.full(4, 3)),
    )
    settings = TransferSettings(mapping=mapping, method="gradients", parts=[0, 1, 1, 1])
    made = plan_transfer(source, target, settings)
    own, carried = common_parts(made)
    assert own.tolist() == [0, 1, 1, 1]
    assert carried.tolist() == [0, 1, 1, 1, 1, 1, 1, 1]  # vertex 3 is in faces 1, 2, 3
