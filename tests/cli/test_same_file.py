"""A source is never its own target, and what is not a model is called by its name."""

from __future__ import annotations

from pathlib import Path

import pytest

import mixseq
from mixseq.errors import FormatError, OutputError, SettingsError
from mixseq.signals.model import Model
from tests.cli.conftest import Contents, Run


@pytest.mark.parametrize(
    "arguments",
    [
        ("convert", "bar.usdc", "bar.usdc"),
        ("convert", "bar.npz", "./bar.npz"),
        ("encode", "bar_sequence.h5", "bar_sequence.h5"),
        ("decode", "model.h5", "model.h5", "--fps", "60"),
    ],
)
def test_the_source_is_not_overwritten(run: Run, contents: Contents, arguments: tuple[str, ...]) -> None:
    before = contents()
    result = run(*arguments)
    assert result.exit_code == 2
    assert "is the source itself and would be lost; give another name" in result.stderr
    assert contents() == before


def test_another_name_for_the_source_is_noticed(run: Run, folder: Path) -> None:
    (folder / "link.usdc").symlink_to(folder / "bar.usdc")
    assert "is the source itself" in run("convert", "bar.usdc", "link.usdc").stderr


@pytest.mark.parametrize("target", ["bar_####.obj", "bar_%02d.obj"])
def test_numbered_sources_are_noticed(run: Run, contents: Contents, target: str) -> None:
    assert run("convert", "bar.npz", "bar_####.obj").exit_code == 0
    before = contents()
    for source in ("bar_####.obj", "bar_0001.obj"):
        result = run("convert", source, target)
        assert (result.exit_code, "is the source itself" in result.stderr) == (2, True)
    assert contents() == before


@pytest.mark.parametrize("options", [(), ("--flatten",)])
def test_what_a_model_was_made_from_is_not_overwritten(
    run: Run, folder: Path, contents: Contents, options: tuple[str, ...]
) -> None:
    assert run("encode", "bar.usdc", "bar.h5").exit_code == 0
    before = contents()
    for command in (("decode",), ("resample",)):
        result = run(*command, "bar.h5", "bar.usdc", *options)
        assert result.exit_code == 2
        assert "bar.usdc is the file that the sequence came from, which would be lost" in result.stderr
    assert contents() == before


def test_models_are_only_saved_under_their_extension(folder: Path, bar_model: Model) -> None:
    with pytest.raises(OutputError, match=r"old\.usdc: models are HDF5 or GLB files; end the name in \.h5"):
        mixseq.save("old.usdc", bar_model)
    assert (folder / "old.usdc").read_bytes() == b"somebody's work"


@pytest.mark.parametrize("name", ["bar.usdc", "bar.npz", "notes.txt"])
def test_forgetting_to_encode_is_explained(folder: Path, name: str) -> None:
    with pytest.raises(FormatError, match=f"{name} is not a model, .* make one with mixseq encode"):
        mixseq.load(name)


def test_times_may_be_rounded_as_printed(bar_model: Model) -> None:
    last = float(bar_model.times[-1])
    rounded = bar_model.header_at([last + 1e-6]).times
    assert rounded.tolist() == [last]
    with pytest.raises(SettingsError, match="outside the sequence"):
        bar_model.header_at([last + 0.01])
