"""Models of several bodies on the command line: one is edited or decoded, or all."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.operations import key_poses, reverse, with_body
from mixseq.signals.model import Model
from tests.cli.conftest import Run
from tests.meshes import bar
from tests.viewer.pages import Opened


@pytest.fixture(scope="module")
def herd() -> Model:
    thin = mixseq.fit(bar(5, 7, 4), exact=True)
    keys = key_poses(thin)
    return with_body(thin, keys.with_points(2 * keys.points), "large")


@pytest.fixture
def stored(folder: Path, herd: Model) -> Path:
    mixseq.save(folder / "herd.h5", herd)
    return folder


def test_one_body_is_decoded(run: Run, stored: Path, herd: Model) -> None:
    assert run("decode", "herd.h5", "one.npz", "--quiet").exit_code == 0
    assert run("decode", "herd.h5", "large.npz", "--body", "large", "--fps", "20", "--quiet").exit_code == 0
    np.testing.assert_allclose(mixseq.read("one.npz").points, herd.sample().points, atol=1e-9)
    np.testing.assert_allclose(mixseq.read("large.npz").points, herd.body("large").sample(fps=20).points, atol=1e-9)


def test_all_bodies_are_decoded(run: Run, stored: Path, herd: Model) -> None:
    result = run("decode", "herd.h5", "all_{body}.npz")
    assert result.exit_code == 0, result.stderr
    assert [line.split()[1] for line in result.stdout.splitlines() if line.startswith("wrote")] == [
        "all_bar.npz",
        "all_large.npz",
    ]
    for name in herd.body_names:
        points = mixseq.read(f"all_{name}.npz").points
        np.testing.assert_allclose(points, herd.body(name).sample().points, atol=1e-9)


def test_morphs_of_a_body(run: Run, stored: Path, herd: Model) -> None:
    assert run("decode", "herd.h5", "large.glb", "--as", "morph", "--body", "large", "--quiet").exit_code == 0
    np.testing.assert_allclose(mixseq.read("large.glb").points, herd.body("large").sample().points, atol=1e-4)


def test_an_edit_is_of_all_bodies(run: Run, stored: Path, herd: Model) -> None:
    (stored / "edits.toml").write_text('[[edit]]\noperation = "reverse"\n')
    assert run("edit", "herd.h5", "back.h5", "--script", "edits.toml", "--body", "large", "--quiet").exit_code == 0
    back = mixseq.load("back.h5")
    assert back.body_names == ("large", "bar")
    for name in back.body_names:
        expected = reverse(herd).body(name).sample().points
        np.testing.assert_allclose(back.body(name).sample().points, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("decode", "herd.h5", "out.npz", "--body", "camel"), "herd.h5: there is no body 'camel'; bodies are 'bar',"),
        (("decode", "herd.h5", "{body}.npz", "--body", "bar"), "stands for all bodies; leave it out, or --body"),
        (("decode", "bar.npz", "out.glb", "--as", "morph", "--body", "bar"), "--body is for models"),
        (("edit", "bar.npz", "out.h5", "--script", "edits.toml", "--body", "bar"), "has one body; leave out --body"),
    ],
)
def test_what_cannot_be_is_refused(
    run: Run, stored: Path, herd: Model, arguments: tuple[str, ...], message: str
) -> None:
    mixseq.write("bar.npz", herd.sample())
    (stored / "edits.toml").write_text('[[edit]]\noperation = "reverse"\n')
    result = run(*arguments)
    assert result.exit_code != 0
    assert message in result.stderr


@pytest.mark.parametrize("suffix", ["h5", "glb"])
def test_all_bodies_are_compressed(run: Run, stored: Path, herd: Model, suffix: str) -> None:
    """Lengths become the smallest fraction of a body, so that the bound holds for each."""
    still = ["--still", "none"] if suffix == "glb" else []
    length = 0.01 * herd.space.scale
    result = run("encode", "herd.h5", f"small.{suffix}", "--max-error", f"{length:.6f}m", *still)
    assert result.exit_code == 0, result.stderr
    assert "left out" not in result.stderr
    assert re.search(r"further bodies +large\n", run("info", f"small.{suffix}").stdout)
    checked = json.loads(run("verify", f"small.{suffix}", "herd.h5", "--json").stdout)
    for body in (checked, checked["bodies"]["large"]):
        assert 0 < body["max_error"] <= body["bound"] <= 0.0051
        assert body["holds"]
    assert "body         large" in run("verify", f"small.{suffix}", "herd.h5").stdout
    mixseq.save("alone.h5", replace(herd, bodies=()))
    assert "compared  no: ORIGINAL has no body of this name" in run("verify", f"small.{suffix}", "alone.h5").stdout
    assert run("decode", f"small.{suffix}", "all_{body}.npz", "--quiet").exit_code == 0
    for name in herd.body_names:
        difference = mixseq.read(f"all_{name}.npz").points - herd.body(name).sample().points
        assert np.linalg.norm(difference, axis=2).max() <= length


def test_a_damaged_body_does_not_verify(run: Run, stored: Path, herd: Model) -> None:
    mixseq.save("small.h5", mixseq.compress(herd, max_error=0.01))
    spoilt = with_body(replace(herd, bodies=()), (keys := key_poses(herd)).with_points(2.1 * keys.points), "large")
    mixseq.save("other.h5", spoilt)
    result = run("verify", "small.h5", "other.h5")
    assert result.exit_code == 1
    assert result.stdout.count("bound holds  yes") == result.stdout.count("bound holds  no") == 1


def test_names_that_are_no_files_are_refused(run: Run, folder: Path, herd: Model) -> None:
    mixseq.save("path.h5", with_body(herd, key_poses(herd), "a/b"))
    result = run("decode", "path.h5", "{body}.npz")
    assert "the body 'a/b' has no name for a file; decode it with --body" in result.stderr


@pytest.mark.parametrize("is_compressed", [False, True])
def test_a_page_shows_all_bodies(run: Run, stored: Path, herd: Model, is_compressed: bool) -> None:
    if is_compressed:
        mixseq.save("herd.h5", mixseq.compress(herd, max_error=0.01))
    result = run("view", "herd.h5", "--export", "herd.html")
    assert result.exit_code == 0, result.stderr
    items = Opened(Path("herd.html")).items
    assert [item.description["name"] for item in items] == ["bar", "large"]
    assert items[1].model.header.vertex_count == herd.bodies[0].header.vertex_count
