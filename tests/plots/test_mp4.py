"""Boxes of MP4: what is written can be read again, and what is damaged is refused."""

from __future__ import annotations

import struct
from io import BytesIO

import pytest

from mixseq.plots.video.mp4 import VideoTrack, joined, read_track, write_track

TRACK = VideoTrack(64, 48, b"av01", b"\0\0\0\x0cav1Cabcd", (b"first", b"second", b"x"), (0, 2))


def written(track: VideoTrack, fps: float = 24) -> bytes:
    file = BytesIO()
    write_track(file, track, fps)
    return file.getvalue()


def number_after(data: bytes, name: bytes, offset: int) -> int:
    """Return the number that stands some bytes after a box's name."""
    value: int = struct.unpack_from(">I", data, data.index(name) + 4 + offset)[0]
    return value


def test_a_track_comes_back() -> None:
    assert read_track(written(TRACK)) == TRACK


def test_samples_of_one_size_come_back() -> None:
    data = written(VideoTrack(64, 48, b"av01", TRACK.settings, (b"ab", b"cd"), (0,)))
    place = data.index(b"stsz") + 4
    short = data[: place + 4] + struct.pack(">II", 2, 2) + data[place + 12 :]
    assert read_track(short).samples == (b"ab", b"cd")


@pytest.mark.parametrize(
    ("fps", "scale", "step"),
    [(24, 24, 1), (24000 / 1001, 24000, 1001), (12.5, 25, 2), (0.25, 1, 4), (1e-4, 1, 10_000)],
)
def test_rates_are_fractions(fps: float, scale: int, step: int) -> None:
    data = written(TRACK, fps)
    assert number_after(data, b"mdhd", 12) == scale
    assert number_after(data, b"mdhd", 16) == 3 * step
    assert number_after(data, b"stts", 12) == step


def test_samples_follow_what_describes_them() -> None:
    data = written(TRACK)
    assert data[4:8] == b"ftyp"
    assert data.index(b"moov") < data.index(b"mdat")
    assert data.endswith(b"firstsecondx")
    assert number_after(data, b"stco", 8) == len(data) - len(b"firstsecondx")


def test_boxes_fill_the_file() -> None:
    data, at, names = written(TRACK), 0, []
    while at < len(data):
        size, name = struct.unpack_from(">I4s", data, at)
        names.append(name)
        at += size
    assert (at, names) == (len(data), [b"ftyp", b"moov", b"mdat"])


def test_equal_tracks_are_equal_files() -> None:
    assert written(TRACK) == written(TRACK)


def test_tracks_are_joined() -> None:
    both = joined([TRACK, TRACK])
    assert both.samples == TRACK.samples * 2
    assert both.keys == (0, 2, 3, 5)


def test_other_settings_are_not_joined() -> None:
    other = VideoTrack(64, 50, b"av01", TRACK.settings, TRACK.samples, (0,))
    with pytest.raises(ValueError, match="other settings"):
        joined([TRACK, other])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "no box moov"),
        (b"\0\0\0\x08free", "no box moov"),
        (struct.pack(">I4s", 4, b"moov"), "shorter than its head"),
        (written(TRACK).replace(b"stco", b"free"), "no chunks"),
    ],
)
def test_damage_is_told(data: bytes, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read_track(data)


def test_chunks_must_hold_the_samples() -> None:
    data = written(TRACK)
    place = data.index(b"stsc") + 4 + 12  # samples per chunk
    with pytest.raises(ValueError, match="2 samples in chunks, but 3 sizes"):
        read_track(data[:place] + struct.pack(">I", 2) + data[place + 4 :])
