"""``mixseq transfer``: what it writes and tells, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from tests.cli.conftest import Contents, Run, succeed
from tests.meshes import tube

pytestmark = pytest.mark.slow


def write_mesh(path: Path, points: FloatArray, faces: Any) -> None:
    mixseq.write(path, MeshSequence.from_arrays(points[None], faces, name=path.stem))


@pytest.fixture
def bar(folder: Path) -> MeshSequence:
    """The bar, and meshes beside it: twice as large, with other triangles, and files about them."""
    bar = mixseq.read(folder / "bar.npz")
    write_mesh(folder / "large.npz", 2 * bar.points[0], bar.faces)
    write_mesh(folder / "first.npz", bar.points[0], bar.faces)
    points, faces = tube(7, 12)
    write_mesh(folder / "fine.npz", points, faces)
    markers = [np.linalg.norm(points - x, axis=1).argmin() for x in bar.points[0, ::9]]
    lines = [f"{9 * number} {vertex}" for number, vertex in enumerate(markers)]
    (folder / "markers.txt").write_text("\n".join(lines))
    nearest = np.linalg.norm(points[:, None] - bar.points[0], axis=2).argmin(axis=1)
    (folder / "map.txt").write_text("# vertices\n" + "\n".join(map(str, nearest)))
    (folder / "feet.json").write_text('{"end": [0, 1]}')
    return bar


@pytest.mark.parametrize("method", ["mixed", "gradients"])
def test_the_same_triangles_need_nothing_else(run: Run, folder: Path, bar: MeshSequence, method: str) -> None:
    text = succeed(run("transfer", "bar.npz", "large.npz", "out.npz", "--method", method))
    out = mixseq.read("out.npz")
    np.testing.assert_allclose(out.points, 2 * bar.points, atol=1e-6 * out.diagonal)
    np.testing.assert_array_equal(out.times, bar.times)
    assert (out.name, out.faces.tolist()) == ("large", bar.faces.tolist())
    lines = text.splitlines()
    assert lines[0].split("  ")[0] == "verdict"
    assert lines[0].endswith("good: corresponds everywhere, and is as smooth as the source; nothing to check")
    assert lines[1].startswith("transferred ")
    assert ("by deformation gradients" in lines[1]) == (method == "gradients")
    assert "corresponds" in lines[2] and "100.0 % of the target's area" in lines[2]
    assert len(lines) <= 10
    assert lines[-2].startswith("wrote out.npz (")
    assert lines[-1].startswith("wrote out-transfer.png (")
    assert (folder / "out-transfer.png").read_bytes().startswith(b"\x89PNG")


def test_a_model_moves_like_its_sequence(run: Run, bar: MeshSequence) -> None:
    assert succeed(run("transfer", "model.h5", "large.npz", "out.usdc", "--quiet", "--no-picture")) == (
        f"wrote out.usdc ({Path('out.usdc').stat().st_size / 1000:.3g} kB)\n"
    )
    out = mixseq.read("out.usdc")
    np.testing.assert_allclose(out.points, 2 * bar.points, atol=1e-5 * out.diagonal)


def test_json_has_the_values_of_the_table(run: Run, bar: MeshSequence) -> None:
    told = json.loads(succeed(run("transfer", "bar.npz", "large.npz", "out.npz", "--json", "--no-picture")))
    assert {name: told[name] for name in ("source", "target", "out", "method", "frames", "vertices")} == {
        "source": "bar.npz",
        "target": "large.npz",
        "out": "out.npz",
        "method": "mixed",
        "frames": bar.frame_count,
        "vertices": bar.vertex_count,
    }
    assert told["correspondence"] is None
    assert told["coverage"] == {"vertices": 1, "area": 1, "source_area": 1, "followers": []}
    assert told["excess_strain"]["max"] < 1e-5
    assert told["acceleration"]["ratio"] == pytest.approx(1)
    assert told["self_intersections"]["frames"] == [0, 1, 2, 3]
    assert told["turned_over"]["worst"] == 0
    assert told["warnings"] == []
    assert told["verdict"]["findings"] == []


def test_a_map_is_kept_and_used_again(run: Run, bar: MeshSequence) -> None:
    options = ("--method", "gradients", "--no-picture", "--quiet")
    succeed(run("transfer", "bar.npz", "fine.npz", "one.npz", "--map", "map.txt", "--save-map", "kept.npz", *options))
    text = succeed(run("transfer", "bar.npz", "fine.npz", "two.npz", "--map", "kept.npz", *options))
    assert text.startswith("wrote two.npz")
    np.testing.assert_array_equal(mixseq.read("one.npz").points, mixseq.read("two.npz").points)


def test_markers_and_their_report(run: Run, bar: MeshSequence) -> None:
    options = ("--markers", "markers.txt", "--save-map", "kept.npz", "--no-picture", "--json")
    told = json.loads(succeed(run("transfer", "bar.npz", "fine.npz", "out.npz", *options)))
    assert told["coverage"]["area"] > 0.95
    assert told["correspondence"]["mean_distance"] < 0.02
    names = [each["name"] for each in told["correspondence"]["markers"]]
    assert names[0].startswith("1 (0 -> ")
    Path("pairs.txt").write_text(
        "\n".join(" ".join(line.split()[::-1]) for line in Path("markers.txt").read_text().splitlines())
    )
    text = succeed(
        run("transfer", "bar.npz", "fine.npz", "two.npz", "--markers", "pairs.txt", "--reverse", "--no-picture")
    )
    lines = [line for line in text.splitlines() if not line.startswith(" ")]  # without wrapped cells
    assert [line.split()[0] for line in lines[2:5]] == ["corresponds", "matched", "markers"]
    np.testing.assert_array_equal(mixseq.read("out.npz").points, mixseq.read("two.npz").points)


def test_rest_as_a_frame_and_as_a_file(run: Run, bar: MeshSequence) -> None:
    backwards = bar.with_points(bar.points[::-1])
    mixseq.write("backwards.npz", backwards)
    for rest in ("3", "-1", "first.npz", "large.npz"):
        options = ("--rest", rest, "--method", "gradients", "--no-picture", "--quiet")
        succeed(run("transfer", "backwards.npz", "large.npz", "out.npz", *options))
        np.testing.assert_allclose(mixseq.read("out.npz").points, 2 * backwards.points, atol=1e-5)


def test_warnings_go_to_stderr_and_into_json(run: Run, bar: MeshSequence) -> None:
    side = [0, 20, 35, 55, 75, 76]  # on one line along the bar, and the middles of its ends
    Path("plane.txt").write_text("\n".join(f"{vertex} {vertex}" for vertex in side))
    options = ("--markers", "plane.txt", "--method", "gradients", "--json", "--no-picture")
    result = run("transfer", "bar.npz", "large.npz", "out.npz", *options)
    assert result.exit_code == 0
    notes = json.loads(result.stdout)["warnings"]
    assert len(notes) == 2
    assert all("are on one plane" in note for note in notes)
    assert result.stderr == "".join(f"mixseq: warning: {note}\n" for note in notes)


def test_contacts_are_in_the_table(run: Run, bar: MeshSequence) -> None:
    options = ("--contacts", "feet.json", "--no-picture", "--parts", "2")
    result = run("transfer", "bar.npz", "large.npz", "out.npz", *options)
    assert result.exit_code == 0, result.stderr
    assert any(line.split()[:1] == ["end"] for line in result.stdout.splitlines())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("bar.npz large.npz bar.npz", "is the source itself"),
        ("bar.npz large.npz large.npz", "is the source itself"),
        ("bar.npz large.npz out.npz --picture large.npz", "is the source itself"),
        ("bar.npz large.npz out.npz --save-map bar.npz", "is the source itself"),
        ("bar.npz large.npz first.npz --rest first.npz", "is the source itself"),
        ("bar.npz large.npz out.npz --save-map out.npz", "written twice"),
        ("bar.npz large.npz out.npz --save-map map.json", "end the name in .npz"),
        ("bar.npz large.npz out.npz --picture out.svg", "end the name in .png"),
        ("bar.npz large.npz out.npz --picture a.png --no-picture", "exclude each other"),
        ("bar.npz large.npz out.xyz", "the extension '.xyz' is not known"),
        ("bar.npz large.npz nowhere/out.npz", "does not exist"),
        ("bar.npz missing.obj out.npz", "missing.obj does not exist"),
        ("bar.npz notes.npz out.npz", "notes.npz"),
        ("missing.npz large.npz out.npz", "missing.npz does not exist"),
        ("bar.npz fine.npz out.npz", "give markers or a map"),
        ("bar.npz other.npz out.npz", "give markers or a map"),
        ("bar.npz fine.npz out.npz --markers markers.txt --map map.txt", "give one of them"),
        ("bar.npz fine.npz out.npz --markers missing.txt", "missing.txt"),
        ("bar.npz fine.npz out.npz --markers feet.json", "feet.json"),
        ("bar.npz large.npz out.npz --map map.txt", "map.txt"),
        ("bar.npz fine.npz out.npz --map missing.npz", "missing.npz"),
        ("bar.npz large.npz out.npz --reverse", "give both, or neither"),
        ("bar.npz large.npz out.npz --rest 4", "there is no frame 4; frames are 0 to 3"),
        ("bar.npz large.npz out.npz --rest other.npz", "give the same mesh"),
        ("bar.npz large.npz out.npz --rest missing.npz", "missing.npz does not exist"),
        ("bar.npz large.npz out.npz --method gradients --parts 2", "leave out --parts"),
        ("bar.npz large.npz out.npz --method gradients --contacts feet.json", "leave out --contacts"),
        ("bar.npz large.npz out.npz --contacts markers.txt", "markers.txt cannot be read as JSON"),
        ("bar.npz large.npz out.npz --labels old.npz --parts 2", "leave out --parts"),
        ("model.h5 large.npz out.npz --labels bar.npz", "the model has its own parts"),
        ("model.h5 large.npz out.npz --input-fps 25", "leave out"),
        ("bar.npz large.npz out.npz --method best", "Invalid value for '--method'"),
    ],
)
def test_refusals_leave_everything_as_it_was(
    run: Run, bar: MeshSequence, contents: Contents, arguments: str, message: str
) -> None:
    before = contents()
    result = run("transfer", *arguments.split())
    assert result.exit_code == 2
    assert message in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert contents() == before


@pytest.mark.realdata
def test_a_wolf_on_a_larger_wolf(run: Run, data: Path) -> None:
    wolf = mixseq.read(data / "npz" / "q_wolf_gallop.npz")
    write_mesh(Path("large.npz"), 3 * wolf.points[0], wolf.faces)
    source = str(data / "npz" / "q_wolf_gallop.npz")
    told = json.loads(succeed(run("transfer", source, "large.npz", "out.npz", "--json")))
    assert told["acceleration"]["ratio"] == pytest.approx(1, abs=1e-6)
    assert told["self_intersections"]["values"] == told["source_self_intersections"]["values"]


def test_a_model_is_transferred_by_its_key_poses(run: Run, folder: Path, bar: MeshSequence) -> None:
    mixseq.save(folder / "bar.h5", mixseq.fit(bar, exact=True))
    succeed(run("transfer", "bar.h5", "large.npz", "two.h5", "--as-body", "large", "--no-picture", "--quiet"))
    succeed(
        run(
            "transfer",
            "two.h5",
            "fine.npz",
            "three.h5",
            "--as-body",
            "fine",
            "--markers",
            "markers.txt",
            "--no-picture",
            "--quiet",
        )
    )
    model, herd = mixseq.load(folder / "bar.h5"), mixseq.load(folder / "three.h5")
    assert herd.body_names == (model.header.name, "large", "fine")
    np.testing.assert_array_equal(herd.time.values, model.time.values)
    large = herd.body("large")
    np.testing.assert_allclose(large.sample().points, 2 * bar.points, atol=1e-5 * large.space.scale)
    whole = mixseq.transfer(model, folder / "fine.npz", folder / "markers.txt")
    np.testing.assert_allclose(herd.body("fine").sample().points, whole.points, atol=5e-3 * large.space.scale)


def test_a_body_that_looks_elsewhere_goes_there(run: Run, folder: Path, bar: MeshSequence) -> None:
    """As all frames do in a transfer: what travels along x goes along its own front."""
    ahead = bar.points + np.arange(bar.frame_count)[:, None, None] * [0.3, 0.0, 0.0]
    moving = mixseq.fit(bar.with_points(ahead), exact=True)
    mixseq.save("moving.h5", moving)
    turned = bar.points[:1] @ np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    mixseq.write("turned.npz", mixseq.MeshSequence.from_arrays(turned, bar.faces, name="turned"))
    succeed(run("transfer", "moving.h5", "turned.npz", "herd.h5", "--as-body", "turned", "--no-picture", "--quiet"))
    made, whole = mixseq.load("herd.h5").body("turned"), mixseq.transfer(moving, "turned.npz")
    assert np.ptp(whole.points[:, 0, 2]) > 0.25 * bar.frame_count
    np.testing.assert_allclose(made.sample().points, whole.points, atol=1e-4 * made.space.scale)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("bar.npz", "large.npz", "out.h5", "--as-body", "b"), "SOURCE and OUT are .h5 files"),
        (("bar.h5", "large.npz", "out.npz", "--as-body", "b"), "SOURCE and OUT are .h5 files"),
        (("bar.h5", "large.npz", "out.h5", "--as-body", "bar"), "bar.h5 has a body 'bar'; give another name"),
        (("bar.h5", "large.npz", "out.h5", "--as-body", "b", "--contacts", "feet.json"), "--contacts"),
    ],
)
def test_as_body_makes_models_of_models(
    run: Run, folder: Path, bar: MeshSequence, arguments: tuple[str, ...], message: str
) -> None:
    mixseq.save(folder / "bar.h5", mixseq.fit(bar, exact=True))
    result = run("transfer", *arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert not (folder / "out.h5").exists()
