"""Encode assets, one after the other or on a cluster, and keep the report up to date."""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import TYPE_CHECKING, Any

import mixseq
from mixseq.cli.batch.plan import Asset
from mixseq.cli.batch.report import Entry, Report, write_report
from mixseq.cli.compressed import compressed
from mixseq.cli.files import Decoded, options_of
from mixseq.errors import GivenUpError, MixseqError, MixseqWarning, OutputError
from mixseq.progress import Progress, silent

if TYPE_CHECKING:
    from mixseq.cluster import Cluster
    from mixseq.mapping import Executor

Settings = Mapping[str, Any]
"""Settings of `mixseq.fit`, those of `mixseq.compress` under ``aim``, of readers under ``reading``; JSON values."""

Work = Callable[[Settings, Iterable[Asset]], Iterator[tuple[Asset, Callable[[], Entry]]]]
"""Yield finished assets, with a function that returns the entry of each."""

UNFINISHED = ".unfinished"
"""Folder of unfinished models."""


def run(
    assets: Iterable[Asset], settings: Settings, earlier: Report, out: Path, work: Work, force: bool
) -> Report:
    """Encode the assets that are not done yet; the report is written before the work, and after every asset."""
    assets = list(assets)
    with _alone(out):
        return _run(assets, settings, earlier, out, work, force)


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Lock the folder while a batch writes there; the system frees the lock if the process dies."""
    try:
        import fcntl
    except ImportError:  # Windows has no such locks
        yield
        return
    folder = os.open(out, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(folder)
        raise OutputError(
            f"{out}: another batch is writing here; wait for it, or give another --out"
        ) from None
    try:
        yield
    finally:
        os.close(folder)


def _run(
    assets: list[Asset], settings: Settings, earlier: Report, out: Path, work: Work, force: bool
) -> Report:
    left = []
    entries: dict[str, Entry] = {}
    for asset in assets:
        before = earlier.entries.get(str(asset.source))
        if before is None or force or not before.holds_for(asset, settings):
            left.append(asset)
            before = Entry.of(asset, settings)
        entries[before.source] = before
    report = Report(entries | {key: entry for key, entry in earlier.entries.items() if key not in entries})
    write_report(out, report)
    try:
        for asset, result in work(settings, left):
            report = report.with_entry(_entry(asset, settings, result))
            write_report(out, report)
    finally:
        shutil.rmtree(out / UNFINISHED, ignore_errors=True)
    report = replace(report, finished=not report.of(assets).count("left"))
    write_report(out, report)
    return report


def _entry(asset: Asset, settings: Settings, result: Callable[[], Entry]) -> Entry:
    try:
        entry = result()
    except GivenUpError as error:
        entry = Entry.of(asset, settings, state="failed", message=str(error))
    if entry.state == "failed" and asset.target.exists():
        return replace(entry, message=f"{entry.message}; an older model is left at {asset.target.name}")
    return entry


def in_turn(workers: Executor, progress: Progress) -> Work:
    """Return a function that encodes assets here, one after the other, the frames of each spread over `workers`."""

    def work(settings: Settings, assets: Iterable[Asset]) -> Iterator[tuple[Asset, Callable[[], Entry]]]:
        left = list(assets)
        for number, asset in enumerate(left, start=1):
            place = f"asset {number} of {len(left)}, {asset.target.stem}"
            entry = encode_asset(settings, asset, workers, _naming(place, progress))
            yield asset, lambda entry=entry: entry  # type: ignore[misc]

    return work


def on_cluster(cluster: Cluster, progress: Progress) -> Work:
    """Return a function that encodes assets on a cluster, each by one worker."""

    def work(settings: Settings, assets: Iterable[Asset]) -> Iterator[tuple[Asset, Callable[[], Entry]]]:
        left = list(assets)
        progress(0, len(left), "encoding assets")
        for done, item in enumerate(cluster.as_done(encode_asset, settings, left), start=1):
            yield item
            progress(done, len(left), "encoding assets")

    return work


def _naming(place: str, progress: Progress) -> Progress:
    return lambda done, total, what: progress(done, total, f"{place}: {what}")


def encode_asset(
    settings: Settings, asset: Asset, workers: Executor | None = None, progress: Progress = silent
) -> Entry:
    """Encode an asset, decode and compare it, then move the model into place; errors are recorded in the entry."""
    try:
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always", MixseqWarning)
            result = _encode(settings, asset, workers, progress)
        said = tuple(str(each.message) for each in told if issubclass(each.category, MixseqWarning))
        return Entry.of(asset, settings, state="done", warnings=said, **result)
    except MixseqError as error:
        message = str(error)
    except OSError as error:
        message = f"{error.filename or asset.source}: {error.strerror or error}"
    except MemoryError:
        message = "there is not enough memory"
    except Exception as error:
        # A bug; the other assets go on.
        message = (
            f"a bug in mixseq, {type(error).__name__}: {error}; `mixseq encode` tells more, please report it"
        )
    return Entry.of(asset, settings, state="failed", message=" ".join(message.split()))


def _encode(settings: Settings, asset: Asset, workers: Executor | None, progress: Progress) -> dict[str, Any]:
    from mixseq.mapping import serially

    mapped = workers or serially
    reading = options_of(asset.source, settings["reading"])
    fitting = {name: value for name, value in settings.items() if name not in ("reading", "aim")}
    unfinished = asset.target.parent / UNFINISHED
    unfinished.mkdir(exist_ok=True)
    with (
        TemporaryDirectory(dir=unfinished) as folder,
        mixseq.open_sequence(asset.source, **reading) as reader,
    ):
        file = Path(folder) / asset.target.name
        start = perf_counter()
        if "aim" in settings:
            mixseq.save(file, compressed(reader, settings["aim"], progress))
        else:
            mixseq.save(file, mixseq.fit(reader, **fitting, progress=progress, workers=mapped))
        seconds = perf_counter() - start
        error = mixseq.compare(reader, Decoded(mixseq.load(file), progress, mapped))
        size = file.stat().st_size
        file.replace(asset.target)
    return {
        "frames": error.frames,
        "vertices": error.vertices,
        "seconds": seconds,
        "max_error": error.as_dict()["max_error"],
        "kg_percent": error.as_dict()["kg_percent"],
        "bytes": size,
        "bits": 8 * size / (error.frames * error.vertices),
    }
