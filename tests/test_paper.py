"""The paper's tables as data, and the measures of scripts/paper."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from mixseq.mesh.topology import Topology
from scripts.paper_study import main
from scripts.paper_study.common.errors import band, errors, folded, text
from scripts.paper_study.common.poses import Poses, between
from scripts.paper_study.common.printed import TABLE_1, TABLE_2, TABLE_3, TABLE_4, edge_dimension
from scripts.paper_study.common.record import load, named, ratio_range
from scripts.paper_study.main import STAGES, write, write_index
from tests.meshes import grid, tetrahedron


@pytest.mark.parametrize("name", TABLE_1)
def test_printed_times_add_up(name: str) -> None:
    row = TABLE_1[name]
    assert row.msgi_init + row.msgi_interpolation - row.msgi_total in (
        0,
        -100,
    )  # -100 on the standing elephant
    assert row.align + row.init + row.interpolation + row.stitching == row.total
    assert row.msgi_total / row.total == pytest.approx(row.speed_up, abs=0.1)
    assert row.dso_iterations * row.dso_iteration == pytest.approx(row.dso_total, rel=0.002)


def test_printed_variants_add_up_but_for_one() -> None:
    wrong = {
        key: row.total - (row.align + row.init + row.interpolation + row.stitching)
        for key, row in [*TABLE_3.items(), *TABLE_4.items()]
        if row.align + row.init + row.interpolation + row.stitching != row.total
    }
    assert wrong == {("horse", 30, 20): 15}  # so it is printed


@pytest.mark.parametrize("name", TABLE_2)
def test_printed_dimensions_of_s_e_count_vertices_too(name: str) -> None:
    faces, vertices, printed = TABLE_1[name].faces, TABLE_1[name].vertices, TABLE_2[name]
    boundary = 19 if name == "horse" else 0
    assert edge_dimension((3 * faces + boundary) // 2, vertices) == printed.edge
    assert printed.edge / printed.mixed == pytest.approx(printed.ratio, abs=0.05)


def test_bands_hold_the_share_that_is_nearest_to_zero() -> None:
    values = np.array([-3.0, -1.0, 0.5, 9.0])
    assert band(values, 1.0) == (-3.0, 9.0)
    assert band(values, 0.75) == (-3.0, 0.5)
    assert band(values, 0.25) == (0.0, 0.5)


def test_errors_of_a_scaled_tetrahedron() -> None:
    points, faces = tetrahedron()
    topology = Topology(faces, len(points))
    frames = np.stack([points, 3.0 * points]).astype(np.float64)
    sequence = cast(Any, SimpleNamespace(faces=faces))
    poses = Poses("lion", (0, 1), frames, sequence, topology)
    right = errors(poses, between(0.5), 2.0 * points)
    assert right.strain == pytest.approx(0, abs=1e-12) and right.degrees == pytest.approx(0, abs=1e-9)
    assert errors(poses, between(0.5), 3.0 * points).strain == pytest.approx(0.5)
    assert errors(poses, between(0.25), 3.0 * points).at(1.0)[0] == pytest.approx(1.0)


def strip(bend: float) -> Poses:
    """A strip of two rows and 21 columns, bent by an angle in its middle, as both poses."""
    x = np.arange(21.0) - 10
    arm = np.stack([np.where(x > 0, np.cos(bend), 1) * x, np.where(x > 0, np.sin(bend), 0) * x], axis=1)
    points = np.concatenate([np.insert(arm, 2, y, axis=1) for y in (0.0, 1.0)])
    faces = grid(1, 20)[1]
    return Poses(
        "lion", (0, 1), np.stack([points, points]), cast(Any, SimpleNamespace(faces=faces)), Topology(faces, 42)
    )


def test_a_strip_that_is_bent_onto_itself_is_folded() -> None:
    straight, bent, onto_itself = strip(0.0), strip(2.0), strip(np.pi)
    found = [errors(straight, between(0.5), poses.points[0]).nearest for poses in (straight, bent, onto_itself)]
    assert found[0] == 1.0 and found[1] == pytest.approx(np.cos(1.0), abs=0.01) and found[2] < 0.25
    ends = bent.along_limbs[0].tolist()
    assert [0, 10] in ends and [0, 20] not in ends  # nor is what passes another limb
    assert folded({"A": {"nearest": 0.8}, "B": {"nearest": 0.3}}).startswith("Folded or shrunk limbs: B (0.3). ")
    assert folded({"A": {"nearest": 0.8}}).startswith("Folded or shrunk limbs: none. ")


def test_numbers_have_two_digits_and_no_exponents() -> None:
    assert text((1e-9, 0.0123, 4.56, 123.4)) == "0 / 0.012 / 4.6 / 123"


@pytest.mark.parametrize("name", STAGES)
def test_every_table_and_figure_has_its_module(name: str) -> None:
    module = import_module(f"scripts.paper_study.stages.{name.replace('-', '_')}")
    assert module.MESHES and all(callable(getattr(module, what)) for what in ("measure", "page", "verdict"))


PAGES = Path(__file__).parents[1] / "docs" / "paper"


def test_pages_are_written_from_their_results(tmp_path: Path) -> None:
    (tmp_path / "results").symlink_to(PAGES / "results")
    for name in STAGES:
        write(tmp_path, name)
    write_index(tmp_path)
    written = sorted(tmp_path.glob("*.md"))
    assert len(written) > len(list((PAGES / "results").glob("*.json")))
    for page in written:
        assert page.read_text() == (PAGES / page.name).read_text(), f"write it: scripts/paper --pages --out {PAGES}"


def test_stages_are_measured_with_one_thread_of_blas(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With more, the last digits of blends of large meshes depend on their number."""

    def measure(*_: object) -> dict[str, object]:
        return {"threads": [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]}

    monkeypatch.setattr(main, "stage", lambda name: SimpleNamespace(measure=measure))
    monkeypatch.setattr(Poses, "of", lambda mesh: None)
    assert main.measured(tmp_path, "table-2", "lion")
    assert set(load(tmp_path, "table-2")["lion"]["threads"]) == {1}


def test_ranges_and_names() -> None:
    assert ratio_range([0.512, 2.04]) == "0.51 to 2" and ratio_range([1.0, 1.001]) == "1"
    assert ratio_range([99.0, 275.3]) == "99 to 275"
    assert named(["lion", "cat"]) == "lion, cat" and named([]) == "none"
