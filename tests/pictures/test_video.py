"""Films: what they show when, from where, and that their files are what they should be."""

from __future__ import annotations

import os
import weakref
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from mixseq.errors import MissingExtraError, OutputError, SettingsError
from mixseq.pictures import film_encoding as encoding
from mixseq.pictures.colours import MEASURES, make_colouring
from mixseq.pictures.film import FilmSettings, divide_picture, draw_backdrop, film, make_cameras, travel_path
from mixseq.pictures.film_encoding import check_film, encode_film, film_format
from mixseq.pictures.raster import Picture, blank_picture
from mixseq.pictures.scene import DecodedItem, SceneItem, film_times, nearest_frames
from mixseq.runtime.parallel import serial_executor, thread_executor
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float

image = pytest.importorskip("PIL.Image")
pytest.importorskip("matplotlib")

SMALL = FilmSettings(size=(96, 64))


def opened(path: Path) -> list[Picture]:
    """Return the frames of a GIF or a WebP."""
    with image.open(path) as file:
        frames = []
        for frame in range(file.n_frames):
            file.seek(frame)
            frames.append(np.asarray(file.convert("RGB")))
        return frames


def decoded(motion: MeshSequence | Model, times: Float) -> DecodedItem:
    return SceneItem("", motion).decode(times)


def still(sequence: MeshSequence) -> MeshSequence:
    return MeshSequence.from_arrays(sequence.points[:1], sequence.faces, name="still")


# Times


def test_a_film_has_the_frames_of_its_sequence(gem: MeshSequence) -> None:
    times, fps = film_times([gem.header])
    assert fps == 24
    assert np.allclose(times, gem.times)
    assert decoded(gem, times).pose_of_frame.tolist() == list(range(9))


def test_it_starts_again_when_the_longest_ends(gem: MeshSequence) -> None:
    short = gem.header.with_times(gem.times[:4])
    times, _ = film_times([short, gem.header], seconds=18 / 24)
    assert nearest_frames(gem.header, times).tolist() == [*range(9), *range(9)]
    assert nearest_frames(short, times).tolist() == 2 * [0, 1, 2, 3, 3, 3, 3, 3, 3]


def test_times_are_since_the_first(gem: MeshSequence) -> None:
    later = gem.header.with_times(gem.times + 100)
    assert np.allclose(film_times([later])[0], gem.times)
    assert nearest_frames(later, gem.times).tolist() == list(range(9))


def test_stills_take_a_while(gem: MeshSequence) -> None:
    times, _ = film_times([still(gem).header], fps=5)
    assert times.tolist() == [0.0] * 20


@pytest.mark.parametrize(("fps", "seconds"), [(24, 1 / 24), (1e9, None), (0.1, 2)])
def test_films_have_some_frames(gem: MeshSequence, fps: float, seconds: float | None) -> None:
    with pytest.raises(SettingsError, match="a film has 2 to 100,000"):
        film_times([gem.header], fps, seconds)


def test_models_are_decoded_at_the_times_of_the_film(gem: MeshSequence) -> None:
    model = fit(gem, space="vertex", exact=True)
    times, _ = film_times([model.header], fps=48, seconds=36 / 48)
    track = decoded(model, times)
    assert len(track.poses) == 17  # twice around; nothing is after the last frame
    assert np.allclose(track.pose(3), model(3 / 48))
    assert np.array_equal(track.pose(17), track.pose(16))
    assert np.array_equal(track.pose(18), track.pose(0))
    assert np.array_equal(track.pose(2), model(gem.times[1]))


# Cameras and panels


def test_the_camera_turns_and_holds_all(gem: MeshSequence) -> None:
    track = decoded(gem, np.zeros(8))
    (camera,) = make_cameras([track], FilmSettings(turn=360), 24)
    assert camera.view_at(2).azimuth == camera.view.azimuth + 90
    left, right, *_ = camera.limits
    assert left < -2
    assert right > 2  # when it is seen from the side
    wide = camera.with_aspect(0.1)
    assert np.isclose(wide.aspect, 0.1)
    assert np.allclose(wide.limits[2:], camera.limits[2:])


def test_one_camera_for_equal_meshes_and_one_for_each_other(gem: MeshSequence) -> None:
    larger = MeshSequence.from_arrays(3 * gem.points, gem.faces)
    other = MeshSequence.from_arrays(gem.points, gem.faces[:, ::-1])
    tracks = [decoded(each, gem.times) for each in (gem, larger, other)]
    first, second, third = make_cameras(tracks, FilmSettings(), 24)
    assert first is second
    assert third.limits[1] < first.limits[1] / 2


def test_cameras_are_in_the_middle_of_what_is_far_away(gem: MeshSequence) -> None:
    away = MeshSequence.from_arrays(gem.points + np.array([100, 5, -40]), gem.faces)
    here, there = (make_cameras([decoded(each, gem.times)], FilmSettings(turn=90), 24)[0] for each in (gem, away))
    assert np.allclose(here.limits, there.limits)
    assert np.allclose(there.centres - here.centres, [100, 5, -40])


def travelling(gem: MeshSequence, steps: Float) -> DecodedItem:
    """A rigid body that goes along x, by ``steps`` ``(N,)`` diagonals of its own at each frame."""
    times = np.arange(len(steps)) / 24
    points = gem.points[:1] + np.multiply.outer(gem.diagonal * np.cumsum(steps), [[1.0, 0, 0]])
    return decoded(MeshSequence.from_arrays(points, gem.faces, times=times), times)


def test_a_camera_that_follows_sees_a_rigid_body_stand_still(gem: MeshSequence) -> None:
    item = travelling(gem, np.full(30, 0.3))
    (following,) = make_cameras([item], FilmSettings(follow=True), 24)
    seen = [item.pose(frame) - following.centres[frame] for frame in range(30)]
    np.testing.assert_allclose(seen, np.broadcast_to(seen[0], np.shape(seen)), atol=1e-12)
    (waiting,) = make_cameras([item], FilmSettings(), 24)
    assert following.limits[1] - following.limits[0] < 0.3 * (waiting.limits[1] - waiting.limits[0])


def test_a_camera_that_follows_does_not_follow_steps(gem: MeshSequence) -> None:
    """The speed goes up and down with every step; the camera's does so a tenth as much."""
    steps = 0.1 * (1 + np.cos(np.arange(97) * np.pi / 4))
    item = travelling(gem, steps)
    speed = np.diff(travel_path(item, 24)[20:77, 0]) / gem.diagonal
    assert np.ptp(speed) < 0.1 * np.ptp(steps)
    assert speed.mean() == pytest.approx(0.1, rel=0.01)


def test_a_camera_is_asked_for_from_the_front(gem: MeshSequence) -> None:
    (camera,) = make_cameras([travelling(gem, np.full(3, 1.0))], FilmSettings(camera=(-20.0, 5.0)), 24)
    assert (camera.view.azimuth, camera.view.elevation) == (70, 5)


@pytest.mark.parametrize(
    ("count", "aspect", "columns"), [(1, 1.0, 1), (3, 2.0, 3), (2, 0.2, 1), (4, 0.5, 2), (5, 1.0, 3)]
)
def test_panels_are_where_meshes_are_largest(count: int, aspect: float, columns: int) -> None:
    panels = divide_picture(count, 640, 360, aspect, True, True)
    assert len({across.start for _, across in panels}) == columns
    taken = np.zeros((360, 640), dtype=int)
    for panel in panels:
        taken[panel] += 1
    assert taken.max() == 1


def test_too_many_panels_are_refused() -> None:
    with pytest.raises(SettingsError, match="50 panels do not fit in 96x64 pixels"):
        divide_picture(50, 96, 64, 1.0, True, False)


def test_names_stay_in_their_panels() -> None:
    panels = divide_picture(2, 200, 100, 1.0, True, False)
    page = draw_backdrop(200, 100, panels, ["", "a name that is much longer than its panel"])
    dark = np.asarray((page < 200).any(axis=2))
    assert dark.any()
    assert not dark[:, :100].any()
    assert not dark[panels[0][0]].any()


# Colours


@pytest.mark.parametrize("colour", ["strain", "curvature"])
def test_changes_are_since_the_first_frame(gem: MeshSequence, colour: str) -> None:
    squeezed = MeshSequence.from_arrays(gem.points * np.linspace(1, 0.5, 9)[:, None, None] ** [0, 1, 0], gem.faces)
    track = decoded(squeezed, squeezed.times[3:])
    change = make_colouring(colour, gem.header, track.pose(0))  # type: ignore[arg-type]
    part = 100 if colour == "strain" else 1  # percent
    assert change.measure is not None
    assert np.array_equal(change.measure(track.pose(0), 0), np.zeros(6))
    for frame in (0, 5):
        expected = part * MEASURES[colour](squeezed.points[3], gem.faces)(squeezed.points[3 + frame])
        assert np.array_equal(change.measure(track.pose(frame), frame), expected)
        assert change.scale_end(track.pose(frame), frame) == np.quantile(expected, 0.99)


def test_errors_are_in_diagonals(gem: MeshSequence) -> None:
    item = SceneItem("gem", gem)
    error = make_colouring("error", gem.header, gem.points[0], original=item.exact_pose)
    assert error.measure is not None
    moved = gem.points[3] + np.array([gem.diagonal, 0, 0])
    assert np.allclose(error.measure(moved, gem.times[3]), 1)


def test_errors_need_one_mesh(gem: MeshSequence, tmp_path: Path) -> None:
    other = MeshSequence.from_arrays(gem.points, gem.faces[:7], name="cut")
    with pytest.raises(SettingsError, match=r"cut has 7 triangles .* errors need the same topology"):
        film(tmp_path / "a.gif", [SceneItem("", other)], FilmSettings(colour="error"), gem)


def test_errors_need_the_same_times(gem: MeshSequence, tmp_path: Path) -> None:
    late = MeshSequence.from_arrays(gem.points, gem.faces, times=gem.times + 1)
    with pytest.raises(SettingsError, match="late starts at 1 s, the original at 0 s"):
        film(tmp_path / "a.gif", [SceneItem("late", late)], FilmSettings(colour="error"), gem)


# Files


@pytest.mark.parametrize("extension", ["gif", "webp"])
def test_the_same_bytes_on_any_number_of_threads(gem: MeshSequence, tmp_path: Path, extension: str) -> None:
    settings = FilmSettings(size=(96, 64), turn=360, colour="strain")
    for name, workers in (("one", serial_executor), ("three", thread_executor(3))):
        film(tmp_path / f"{name}.{extension}", [SceneItem("gem", gem)], settings, workers=workers)
    one, three = ((tmp_path / f"{name}.{extension}").read_bytes() for name in ("one", "three"))
    assert one == three


def test_poses_on_disk_make_the_same_film(gem: MeshSequence, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = fit(gem, space="vertex", exact=True)
    for name, most in (("memory", 1 << 28), ("disk", 0)):
        monkeypatch.setattr("mixseq.runtime.low_memory.MAX_BYTES_IN_MEMORY", most)
        film(tmp_path / f"{name}.gif", [SceneItem("", model)], SMALL, workers=thread_executor(2))
    assert (tmp_path / "memory.gif").read_bytes() == (tmp_path / "disk.gif").read_bytes()


@pytest.mark.parametrize("extension", ["gif", "webp"])
def test_a_film_that_is_interrupted_leaves_the_old_one(gem: MeshSequence, tmp_path: Path, extension: str) -> None:
    def interrupt(done: int, total: int, what: str) -> None:
        if what == "drawing frames" and done == 7:
            raise KeyboardInterrupt

    target = tmp_path / f"a.{extension}"
    target.write_text("old")
    with pytest.raises(KeyboardInterrupt):
        film(target, [SceneItem("", gem)], SMALL, progress=interrupt)
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_webp_is_encoded_while_it_is_drawn(tmp_path: Path) -> None:
    alive: list[weakref.ref[Picture]] = []

    def draw(frames: Iterable[int]) -> Iterator[Picture]:
        for frame in frames:
            assert sum(picture() is not None for picture in alive) <= 2
            picture = np.full((64, 64, 3), 10 * frame, dtype=np.uint8)
            alive.append(weakref.ref(picture))
            yield picture

    encode_film(tmp_path / "a.webp", "webp", draw, 20, 24)
    assert len(opened(tmp_path / "a.webp")) == 20


def test_a_pipe_behind_a_link_is_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "a.gif").symlink_to(tmp_path / "pipe")
    with pytest.raises(OutputError, match=r"a\.gif is no regular file"):
        encode_film(tmp_path / "a.gif", "gif", lambda _: pytest.fail("drawn"), 1, 1)
    assert (tmp_path / "a.gif").is_fifo()


def test_gifs_have_a_longest_duration(tmp_path: Path) -> None:
    def draw(frames: Iterable[int]) -> Iterator[Picture]:
        return (blank_picture(64, 64) for _ in frames)

    encode_film(tmp_path / "a.gif", "gif", draw, 655, 1)
    with pytest.raises(SettingsError, match="the film takes 656 s, a GIF at most 655 s"):
        encode_film(tmp_path / "a.gif", "gif", draw, 656, 1)


@pytest.mark.parametrize("extension", ["gif", "webp"])
def test_frames_are_what_was_drawn(tmp_path: Path, extension: str) -> None:
    ramp = np.linspace(0, 255, 80).astype(np.uint8)
    pictures = [blank_picture(80, 60) for _ in range(5)]
    for number, picture in enumerate(pictures):
        picture[10 + number : 30 + number] = ramp[:, None]
    pictures[3] = pictures[2]  # nothing changes

    def draw(frames: Iterable[int]) -> Iterator[Picture]:
        return (pictures[frame] for frame in frames)

    path = tmp_path / f"a.{extension}"
    encode_film(path, extension, draw, 5, 10)  # type: ignore[arg-type]
    shown = opened(path)
    for number, picture in enumerate([*pictures[:3], pictures[4]]):  # frames that are the same are joined
        assert np.abs(shown[number].astype(int) - picture).max() <= (8 if extension == "gif" else 24)
        assert (shown[number][0, 0] >= (255 if extension == "gif" else 253)).all()


def test_a_gif_keeps_its_rate(gem: MeshSequence, tmp_path: Path) -> None:
    film(tmp_path / "a.gif", [SceneItem("", gem)], SMALL)
    with image.open(tmp_path / "a.gif") as file:
        durations = []
        for frame in range(file.n_frames):
            file.seek(frame)
            durations.append(file.info["duration"])
        assert file.info["loop"] == 0
    assert sum(durations) == pytest.approx(1000 * 9 / 24, abs=5)
    assert set(durations) <= {40, 50}


def test_the_film_shows_the_meshes(gem: MeshSequence, tmp_path: Path) -> None:
    squeezed = MeshSequence.from_arrays(gem.points * [1, 0.3, 1], gem.faces)
    film(tmp_path / "a.gif", [SceneItem("", gem), SceneItem("", squeezed)], FilmSettings(size=(160, 80)))
    frames = opened(tmp_path / "a.gif")
    assert len(frames) == 9
    dark = np.asarray((frames[0] < 200).any(axis=2))
    one, other = dark[:, :80].sum(), dark[:, 80:].sum()
    assert one > 1.5 * other > 0
    assert (frames[0] != frames[4]).any()


def test_parts_are_coloured_also_of_the_original(bent_bar: MeshSequence, bar_model: Model, tmp_path: Path) -> None:
    settings = FilmSettings(size=(160, 80), colour="parts")
    film(tmp_path / "a.gif", [SceneItem("", bent_bar), SceneItem("", bar_model)], settings)
    grey = np.ptp(opened(tmp_path / "a.gif")[0].astype(int), axis=2)
    assert (grey[:, :80] > 40).any()
    assert (grey[:, 80:] > 40).any()


def test_colours_show_where_it_bends(tmp_path: Path) -> None:
    flat = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0.0]])
    faces = [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]]
    bend = np.where(flat[:, :1] == 2, [[-0.3, 0, 0.6]], 0)
    strip = MeshSequence.from_arrays(flat + np.linspace(0, 1, 3)[:, None, None] * bend, faces)
    film(tmp_path / "a.gif", [SceneItem("", strip)], FilmSettings(size=(160, 96), colour="curvature"))
    first, *_, last = (frame[:80].astype(int) for frame in opened(tmp_path / "a.gif"))  # without the bar
    yellow = [np.minimum(frame[..., 0], frame[..., 1]) - frame[..., 2] > 60 for frame in (first, last)]
    assert not yellow[0].any()
    assert yellow[1].any()


@pytest.mark.parametrize("colour", ["strain", "curvature"])
def test_degenerate_meshes_are_survived(tmp_path: Path, colour: Any) -> None:
    point = MeshSequence.from_arrays(np.zeros((3, 3, 3)), [[0, 1, 2]])
    film(tmp_path / "a.gif", [SceneItem("", point)], FilmSettings(size=(96, 64), turn=90, colour=colour))
    assert len(opened(tmp_path / "a.gif")) == 1  # nothing changes


# Refusals


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"colour": "pink"}, "'pink'; choose one of values, clay, own, parts, error, strain, curvature"),
        ({"fps": 0}, "fps is 0; a positive number"),
        ({"seconds": float("inf")}, "the duration is inf"),
        ({"turn": float("nan")}, "the turn is nan"),
        ({"camera": (0.0, float("inf"))}, r"the camera is at \(0.0, inf\); two numbers"),
        ({"scale": 1}, "only the colours error, strain and curvature have a scale"),
        ({"scale": -1, "colour": "strain"}, "the scale is -1"),
    ],
)
def test_settings_out_of_range(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        FilmSettings(**settings)


def test_what_cannot_be_shown(gem: MeshSequence, tmp_path: Path) -> None:
    path = tmp_path / "a.gif"
    for shown, colour, against, message in (
        ([], "clay", None, "no mesh to show"),
        ([SceneItem("", gem)], "error", None, "needs the original"),
        ([SceneItem("", gem)], "clay", gem, "only the colour error needs the original"),
        ([SceneItem("", gem)], "parts", None, "gem has no parts"),
        ([SceneItem("", fit(gem, space="vertex"))], "parts", None, "gem has no parts"),
    ):
        with pytest.raises(SettingsError, match=message):
            film(path, shown, FilmSettings(colour=colour), against)  # type: ignore[arg-type]
    assert not path.exists()


def test_formats_are_told_by_extension() -> None:
    assert film_format("a.b.MP4") == "mp4"
    for name in ("a.avi", "mp4", "a"):
        with pytest.raises(OutputError, match=r"end the name in \.mp4, \.gif or \.webp"):
            film_format(name)


@pytest.mark.parametrize(
    ("form", "size", "fps", "message"),
    [
        ("gif", (63, 64), None, "63x64; films have 64 to 8192 pixels"),
        ("webp", (64, 8193), None, "films have 64 to 8192"),
        ("mp4", (641, 360), None, "MP4 needs even numbers, 641 could be 642"),
        ("gif", (64, 64), 60, "60 frames per second are too many for GIF"),
    ],
)
def test_what_formats_cannot_hold(form: Any, size: tuple[int, int], fps: float | None, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        check_film(form, size, fps)


def test_missing_encoders_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("PIL.features.get_supported_modules", lambda: ["pil"])
    with pytest.raises(MissingExtraError, match=r"without WebP; .* pip install 'pillow>=11.3'"):
        check_film("webp", (64, 64))
    check_film("gif", (64, 64))


def test_without_pillow(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> NoReturn:
        raise ImportError(name)

    monkeypatch.setattr(encoding, "import_module", missing)
    with pytest.raises(MissingExtraError, match=r"films need Pillow; .* pip install 'mixseq\[plot\]'"):
        check_film("gif", (64, 64))
