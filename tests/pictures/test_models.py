"""Whole pictures of models: every kind, both formats, equal bytes, and what is refused."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.choices import PICTURES, PictureKind
from mixseq.errors import MissingExtraError, OutputError, SettingsError
from mixseq.pictures.charts import Format
from mixseq.pictures.models import MAX_ERROR_FRAMES, _page_section, _parts, check_settings, plot_model, summary
from mixseq.pictures.scene import three_quarter_view
from mixseq.runtime.progress import log_progress
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from tests.pictures.conftest import LOW_RESOLUTION
from tests.pictures.test_sheets import png_size

pytestmark = pytest.mark.slow

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def vertex_model(bent_bar: MeshSequence) -> Model:
    return fit(bent_bar, rank=1, space="vertex")


def picture(model: Model, kind: PictureKind | None = None, file_format: Format = "png", **settings: Any) -> bytes:
    file = io.BytesIO()
    plot_model(file, model, kind, file_format=file_format, **settings)
    return file.getvalue()


@pytest.mark.parametrize(("kind", "file_format"), [*((kind, "svg") for kind in PICTURES), ("parts", "png")])
def test_every_kind_is_reproducible(
    kind: PictureKind, file_format: Format, bar_model: Model, bent_bar: MeshSequence
) -> None:
    against = bent_bar if kind.startswith("error") else None
    settings = {"against": against, "values": np.arange(77.0) if kind == "values" else None}
    first = picture(bar_model, kind, file_format, **settings)
    assert first == picture(bar_model, kind, file_format, **settings)
    assert len(first) > 2000
    if file_format == "svg":
        assert b"<svg" in first
        assert b"dc:date" not in first
        assert len(first) < 1_000_000


def test_overview_has_a_row_for_what_there_is(bar_model: Model, vertex_model: Model, bent_bar: MeshSequence) -> None:
    def height(model: Model, against: MeshSequence | None = None) -> float:
        return _page_section(model, None, against, None, None, None, None, log_progress).height

    ends = np.stack([bar_model(bar_model.start), bar_model(bar_model.end)])
    near = three_quarter_view(ends, bar_model.header.up_axis)
    assert height(vertex_model) == pytest.approx(3.6)
    assert height(bar_model) == pytest.approx(3.6 + _parts(bar_model, near, 6.7).height)
    for model in (vertex_model, bar_model):
        assert height(model, bent_bar) > height(model) + 3


def test_overview(bar_model: Model, bent_bar: MeshSequence) -> None:
    assert png_size(picture(bar_model, against=bent_bar, tolerance=0.01))[0] > 10 * LOW_RESOLUTION


def test_frames_are_rows_of_errors(vertex_model: Model, bent_bar: MeshSequence) -> None:
    one, two = (
        png_size(picture(vertex_model, "error-vertices", against=bent_bar, frames=frames))[1]
        for frames in ([1], [1, 3, 1])
    )
    assert one < two < 2 * one


def test_values_are_drawn_of_one_frame_or_of_three(vertex_model: Model) -> None:
    constant = np.arange(77.0)
    one, two, three = (
        png_size(picture(vertex_model, "values", values=values, frames=frames))[1]
        for values, frames in ((constant, None), (constant, [0, 2]), (constant * np.arange(4)[:, None], None))
    )
    assert one < two < three


def test_extension_decides(vertex_model: Model, tmp_path: Path) -> None:
    plot_model(tmp_path / "a.svg", vertex_model, "coefficients")
    assert (tmp_path / "a.svg").read_bytes() == picture(vertex_model, "coefficients", "svg")
    with pytest.raises(OutputError, match=r"a\.gif: pictures are PNG or SVG files"):
        plot_model(tmp_path / "a.gif", vertex_model)


def test_progress_is_told(vertex_model: Model, bent_bar: MeshSequence) -> None:
    told: list[str] = []
    picture(
        vertex_model,
        "error-frames",
        against=bent_bar,
        progress=lambda done, total, what: told.append(f"{what} {done}/{total}"),
    )
    assert told == ["decoding frames 4/4"]


def test_summary_counts(vertex_model: Model) -> None:
    assert summary(vertex_model) == (
        "bar: 4 frames (0 to 3) in 0.3 s, 77 vertices; 2 key shapes in a vertex space of dimension 231"
    )


@pytest.mark.parametrize(
    ("kind", "against", "frames", "tolerance", "message"),
    [
        ("pie", False, None, False, "kind is 'pie'; one of embedding, coefficients"),
        ("error-frames", False, None, False, "error-frames needs the original"),
        ("error-vertices", False, None, False, "error-vertices needs the original"),
        (None, False, None, True, "tolerance needs the original"),
        ("embedding", True, None, False, "against is for error-frames and error-vertices, not for embedding"),
        (
            "coefficients",
            False,
            [1],
            False,
            "frames is for embedding and error-vertices and values, not for coefficients",
        ),
        ("error-vertices", True, None, True, "tolerance is for error-frames, not for error-vertices"),
        ("error-vertices", True, range(MAX_ERROR_FRAMES + 1), False, "do not fit; choose 1 to 12 frames"),
        ("error-vertices", True, [], False, "do not fit; choose 1 to 12 frames"),
        ("values", False, None, False, "values needs numbers of the vertices"),
    ],
)
def test_settings_that_contradict(kind: Any, against: bool, frames: Any, tolerance: bool, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        check_settings(kind, against, frames, tolerance)


@pytest.mark.parametrize("tolerance", [0.0, np.nan])
def test_tolerance_is_positive(bar_model: Model, bent_bar: MeshSequence, tolerance: float) -> None:
    with pytest.raises(SettingsError, match=f"tolerance is {tolerance}; a positive number"):
        plot_model(io.BytesIO(), bar_model, "error-frames", file_format="png", against=bent_bar, tolerance=tolerance)


def test_meshes_are_seen_from_the_camera_and_its_other_side(bar_model: Model) -> None:
    front = picture(bar_model, "parts", camera=(0.0, 0.0))
    assert front == picture(bar_model, "parts", camera=(360.0, 0.0))
    assert front != picture(bar_model, "parts", camera=(90.0, 0.0))


def test_parts_need_a_space_with_parts(vertex_model: Model) -> None:
    with pytest.raises(SettingsError, match="the vertex space has no parts"):
        picture(vertex_model, "parts")


@pytest.mark.parametrize("kind", ["embedding", "error-vertices", None])
def test_frames_must_exist(kind: PictureKind | None, vertex_model: Model, bent_bar: MeshSequence) -> None:
    against = None if kind == "embedding" else bent_bar
    with pytest.raises(SettingsError, match="there is no frame 4; choose frames from 0 to 3"):
        picture(vertex_model, kind, against=against, frames=[4])


def test_without_matplotlib_the_message_names_the_cure(vertex_model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=r"pip install 'mixseq\[plot\]'"):
        picture(vertex_model)


@pytest.mark.parametrize("kind", ["embedding", "coefficients", "singular-values", "error-frames"])
@pytest.mark.parametrize("frames", [1, 2])
def test_very_short_sequences(frames: int, kind: PictureKind, bent_bar: MeshSequence) -> None:
    short = MeshSequence.from_arrays(bent_bar.points[:frames], bent_bar.faces, fps=10)
    against = short if kind == "error-frames" else None
    assert picture(fit(short, exact=True, space="vertex"), kind, against=against)
