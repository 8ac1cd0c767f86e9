"""Plan a batch: find the sequences, and choose the paths of their models."""

from __future__ import annotations

import re
import warnings
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from mixseq.cli.files import is_model
from mixseq.errors import FormatError, MixseqWarning, OutputError

_LAST_NUMBER = re.compile(r"(\d+)(?=\D*$)")


@dataclass(frozen=True)
class Asset:
    """A sequence to encode."""

    # Its file, or the pattern of its numbered files; absolute, as another process may have another folder.
    source: Path
    target: Path  # the model to write, absolute
    size: int  # bytes of the source, all of its files together
    signature: str  # hash of the names, sizes and modification times of its files


def find_sources(paths: Iterable[Path]) -> list[Path]:
    """Return the absolute paths of sequences, each once: files and patterns as they are, folders searched.

    In a folder, without its subfolders, these are files of formats for sequences, and numbered files. Models and the
    meshes of point caches are left out, and other single meshes with a warning.
    """
    found: dict[Path, None] = {}
    for path in paths:
        sources = sorted(_in_folder(path)) if path.is_dir() else [path]
        if not sources:
            raise FormatError(
                f"{path}: there are no sequences in this folder; `mixseq formats` lists what can be read"
            )
        for source in sources:
            if not files_of(source):
                raise FormatError(f"{source} does not exist")
            found[source.parent.resolve() / source.name] = None
    return list(found)


def files_of(source: Path) -> list[Path]:
    """Return the file of a sequence, or its numbered files; empty if they do not exist."""
    from mixseq_io.numbered.names import files_of_pattern

    return [source] if source.exists() else [file for _, file in files_of_pattern(source)]


def plan(sources: Sequence[Path], out: Path, names: Mapping[str, str]) -> tuple[Asset, ...]:
    """Choose the paths of models: ``walk.h5`` for ``walk.usdc``, or ``walk.usdc.h5`` if there is another walk."""
    taken = {name.casefold() for name in names.values()}
    stems = Counter(stem_of(source).casefold() for source in sources if str(source) not in names)
    owners: dict[str, Path | str] = {
        name.casefold(): other for other, name in names.items() if Path(other) not in set(sources)
    }
    assets = []
    for source in sources:
        stem = stem_of(source)
        alone = stems[stem.casefold()] == 1 and f"{stem}.h5".casefold() not in taken
        name = names.get(str(source)) or (f"{stem}.h5" if alone else f"{stem}{source.suffix}.h5")
        other = owners.setdefault(name.casefold(), source)
        if other is not source:
            raise OutputError(
                f"{source} and {other} would both be written to {out / name}; give one of them another --out"
            )
        target = out.resolve() / name
        if target in sources:
            raise OutputError(f"{target} is a source itself and would be lost; give another --out")
        assets.append(Asset(source, target, *_signed(files_of(source))))
    return tuple(assets)


def _signed(files: Iterable[Path]) -> tuple[int, str]:
    """Return the total size of files, and a hash that changes with any of them."""
    states = sorted((file.name, (state := file.stat()).st_size, state.st_mtime_ns) for file in files)
    return sum(size for _, size, _ in states), sha256(repr(states).encode()).hexdigest()


def stem_of(source: Path) -> str:
    """Return the name of a sequence: numbered files without their number, or their folder's name if nothing is left.

    >>> [stem_of(Path("shots") / name) for name in ("walk.usdc", "run_####.obj", "%04d.ply")]
    ['walk', 'run', 'shots']
    """
    from mixseq_io.numbered.names import is_pattern

    if source.is_dir():
        return source.name
    if not is_pattern(source):
        return source.stem
    return re.sub(r"[ ._-]*(#+|%\d*d)", "", source.stem) or source.parent.name


def _in_folder(folder: Path) -> Iterator[Path]:
    from mixseq_io import FORMATS

    formats = {extension: each for each in FORMATS for extension in each.extensions}
    series: dict[str, list[str]] = defaultdict(list)
    caches = set()
    single = []
    for file in sorted(folder.iterdir()):
        form = formats.get(file.suffix.lower())
        if form is None or file.name.startswith(".") or not file.is_file():
            continue
        if not form.numbered:
            if not _is_model(file):
                if "mesh" in form.read_options:
                    caches.add(file.stem)
                yield file
        elif number := _LAST_NUMBER.search(file.stem):
            around = file.stem[: number.start()], file.stem[number.end() :] + file.suffix
            series["\0".join(around)].append(number[1])
        else:
            single.append(file.name)
    for names, numbers in series.items():
        before, after = names.split("\0")
        if len(numbers) > 1:
            yield folder / f"{before}{'#' * min(map(len, numbers))}{after}"
        else:
            single.append(f"{before}{numbers[0]}{after}")
    _tell_of_single(folder, [name for name in single if Path(name).stem not in caches])


def _is_model(file: Path) -> bool:
    """Return whether a file is a model; an unreadable one is an asset that will fail."""
    with suppress(FormatError):
        return is_model(file)
    return False


def _tell_of_single(folder: Path, names: list[str]) -> None:
    if names:
        shown = ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
        warnings.warn(
            f"{folder}: single meshes are no sequences and are left out: {shown}", MixseqWarning, stacklevel=2
        )
