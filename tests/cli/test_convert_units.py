"""--convert-axes and --convert-units, in all commands that write sequences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.sequence.sequence import MeshSequence
from tests.cli.conftest import Run

CONVERTED = ("--convert-axes", "Z", "--convert-units", "cm")


def expected(points: np.ndarray) -> np.ndarray:
    x, y, z = np.moveaxis(np.asarray(points, np.float64), -1, 0)
    return 100 * np.stack([x, -z, y], axis=-1)


@pytest.mark.parametrize(
    "command",
    [
        ("convert", "bar.npz", "out.npz"),
        ("decode", "model.h5", "out.npz"),
        ("resample", "bar.npz", "out.npz", "--velocities"),
        ("interpolate", "bar.npz", "out.npz", "--pose", "0=1"),
        ("transfer", "bar.npz", "bar.npz", "out.npz", "--no-picture"),
    ],
    ids=lambda command: command[0],
)
def test_commands_turn_and_scale(command: tuple[str, ...], run: Run) -> None:
    assert run(*command, "-q").exit_code == 0
    plain = mixseq.read("out.npz")
    assert run(*command, *CONVERTED, "-q", "--overwrite").exit_code == 0
    turned = mixseq.read("out.npz")
    assert (turned.up_axis, turned.metres_per_unit) == ("Z", 0.01)
    np.testing.assert_allclose(turned.points, expected(plain.points), rtol=1e-6, atol=1e-6)
    if plain.velocities is not None:
        assert turned.velocities is not None
        np.testing.assert_allclose(turned.velocities, expected(plain.velocities), rtol=1e-5, atol=1e-4)
    assert (plain.velocities is not None) == ("--velocities" in command)


def test_the_mesh_beside_a_cache(run: Run, bent_bar: MeshSequence) -> None:
    assert run("convert", "bar.npz", "bar.pc2", *CONVERTED, "-q").exit_code == 0
    np.testing.assert_allclose(mixseq.read("bar.obj").points[0], expected(bent_bar.points[0]), rtol=1e-6, atol=1e-5)


def test_onto_an_original_in_other_units(run: Run) -> None:
    """What does not fit says what makes it fit."""
    assert run("convert", "bar.usdc", "shot.usdc", "--flatten", *CONVERTED, "-q").exit_code == 0
    refused = run("convert", "bar.npz", "layer.usdc", "--onto", "shot.usdc", "-q")
    assert refused.exit_code == 2
    assert "has Z up, the sequence Y; convert_units (--convert-axes Z) turns it" in refused.stderr
    refused = run("convert", "bar.npz", "layer.usdc", "--onto", "shot.usdc", "--convert-axes", "Z", "-q")
    assert "of 1 m; convert_units (--convert-units 0.01) scales it" in refused.stderr
    assert run("convert", "bar.npz", "layer.usdc", "--onto", "shot.usdc", *CONVERTED, "-q").exit_code == 0
    assert b"shot.usdc" in Path("layer.usdc").read_bytes()
    np.testing.assert_allclose(mixseq.read("layer.usdc").points, mixseq.read("shot.usdc").points, rtol=1e-6)


def test_formats_without_units_name_the_options(run: Run) -> None:
    assert run("convert", "bar.npz", "z.npz", *CONVERTED, "-q").exit_code == 0
    told = run("convert", "z.npz", "z_####.obj", "-q").stderr
    assert "Z up, 0.01 metres per unit" in told
    assert "convert_units (--convert-axes Y, --convert-units m) turns and scales the sequence" in told
    assert "(--convert-axes Y, --convert-units m)" in run("convert", "z.npz", "z.glb", "-q").stderr
    told = run("convert", "z.npz", "y_####.obj", "--convert-axes", "Y", "--convert-units", "1", "-q").stderr
    assert "convert" not in told


def test_units_that_are_none(run: Run) -> None:
    refused = run("convert", "bar.npz", "out.npz", "--convert-units", "parsec")
    assert refused.exit_code == 2
    assert refused.stderr == (
        "mixseq: error: Invalid value for '--convert-units': the unit is 'parsec'; one of mm, cm, m, km, in, ft, yd is "
        "expected, or its length in metres (see mixseq convert --help)\n"
    )
    assert not Path("out.npz").exists()


def test_models_have_no_other_units(run: Run) -> None:
    Path("none.toml").write_text("")
    refused = run("edit", "model.h5", "out.h5", "--script", "none.toml", *CONVERTED)
    assert "--convert-axes is for sequences" in refused.stderr


@pytest.mark.parametrize(("unit", "metres"), [("cm", 0.01), ("in", 0.0254), ("0.25", 0.25)])
def test_units_of_files_without_are_named(unit: str, metres: float, run: Run) -> None:
    assert run("convert", "bar.npz", "bar_####.obj", "-q").exit_code == 0
    assert run("convert", "bar_####.obj", "out.npz", "--units", unit, "-q").exit_code == 0
    assert mixseq.read("out.npz").metres_per_unit == metres
    np.testing.assert_allclose(mixseq.read("out.npz").points, mixseq.read("bar_####.obj").points)


def test_unknown_units_are_refused_in_one_line(run: Run) -> None:
    for option in ("--units", "--convert-units"):
        result = run("convert", "bar.npz", "out.npz", option, "parsec")
        assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
        assert "the unit is 'parsec'; one of mm, cm, m, " in result.stderr
