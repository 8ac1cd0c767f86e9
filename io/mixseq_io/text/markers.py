"""Read and write markers, which are pairs of vertices of a source and a target mesh, and read contacts.

Files are JSON, YAML, or text with a marker per line; ``docs/transfer.md`` describes all three. YAML defines ``12:34``
as a time of day (754 seconds), but here it is read as a pair. The viewer also writes the `NumberedVertices` of both
meshes, by which markers are found in files with other numbers: as ``"meshes": {"source": object, "target": object}`` in
JSON, or a comment ``# meshes`` with this object.

Contacts are named groups of target vertices that rest on the ground, such as feet. Vertices are numbered from 0.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mixseq.errors import FormatError, MissingExtraError
from mixseq.retargeting.markers import Markers
from mixseq.runtime.public import public
from mixseq.runtime.text_files import decode_text
from mixseq.types import PathLike
from mixseq_io.files import atomic_file
from mixseq_io.reader import read_bytes, summarize_error, translate_read_errors

if TYPE_CHECKING:
    from mixseq.compression.numbering import NumberedVertices


def read_text(file: Path, what: str) -> str:
    """Read a UTF-8 file, with or without a byte order mark; `what` names the expected contents in messages."""
    with translate_read_errors(file, what):
        return decode_text(file, read_bytes(file, text=True), what)


def parse_json(file: Path, text: str) -> Any:
    """Parse the text of a JSON file."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits also raise ValueError
        raise FormatError(f"{file} cannot be read as JSON: {summarize_error(error)}") from None


def read_contacts(path: PathLike) -> dict[str, list[int]]:
    """Read contacts from a JSON file, such as ``{"left": [3, 4], "right": [7]}``."""
    file = Path(path)
    groups = parse_json(file, read_text(file, "contacts"))
    if isinstance(groups, dict) and isinstance(groups.get("contacts"), dict):
        groups = groups["contacts"]
    if not isinstance(groups, dict) or not groups:
        raise FormatError(f'{file} has no contacts; an object such as {{"left foot": [12, 13]}} is expected')
    for name, vertices in groups.items():
        if not isinstance(vertices, list) or not vertices:
            raise FormatError(f"{file}: contact '{name}' is not a list of vertices; give numbers from 0")
        wrong = [vertex for vertex in vertices if type(vertex) is not int or vertex < 0]
        if wrong:
            raise FormatError(f"{file}: contact '{name}' has {wrong[0]!r}; vertices are numbered from 0")
    return groups


YAML_EXTENSIONS = (".yml", ".yaml")

_PAIR_PATTERN = re.compile(r"(\d+)\s*(?:->|[\s,:;])\s*(\d+)")
_MESHES_PATTERN = re.compile(r"^# meshes (\{.*\})\s*$", re.MULTILINE)
_SIDES = ("source", "target")
_COUNT_PATTERN = re.compile(r"\d{1,18}")
_HEADING_PATTERN = re.compile(r"source\s*(?:->|[\s,:;])\s*target", re.IGNORECASE)
_PAIR_TEXT = "two vertex numbers, from 0, are expected, separated by a space, comma, colon, semicolon or '->'"


_RawMarkers = list[tuple[str, Any, str]]
"""Location in the file, value and comment of every marker, before they are checked."""


@public
def read_markers(path: PathLike, *, reverse: bool = False) -> Markers:
    r"""Read markers from a file.

    Parameters
    ----------
    path : path-like
        File in JSON, YAML or with a marker per line, see ``docs/transfer.md``.
    reverse : bool
        Exchange source and target, for files in which the target's vertices come first.

    Returns
    -------
    Markers
        The markers, with names if at least one marker has a name. `mixseq.retargeting.checks.check_markers` checks
        whether markers fit two meshes.

    Raises
    ------
    FormatError
        If the file is missing or is not a list of pairs; the message names the line or the marker.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "markers.txt")
    ...     _ = file.write_text("750, 3386  # nose\n524 -> 3737")
    ...     markers = read_markers(file)
    >>> markers.source.tolist(), markers.target.tolist(), markers.names
    ([750, 524], [3386, 3737], ('nose', ''))
    """
    file = Path(path)
    if file.suffix.lower() == ".npz" and file.exists():
        raise FormatError(f"{file} is a map, not a list of markers; give it as the map (--map)")
    text, extension = read_text(file, "markers"), file.suffix.lower()
    if extension in YAML_EXTENSIONS:
        raw_markers = _parse_yaml(file, text)
    elif extension == ".json":
        values = enumerate(_find_list(file, parse_json(file, text)), start=1)
        raw_markers = [(f"marker {number}", value, "") for number, value in values]
    else:
        raw_markers = _parse_lines(file, text)
    if not raw_markers:
        raise FormatError(f"{file} has no markers; {_PAIR_TEXT}")
    markers = [_parse_marker(f"{file}, {location}", *raw) for location, *raw in raw_markers]
    pairs = [(target, source) if reverse else (source, target) for source, target, _ in markers]
    names = tuple(name for _, _, name in markers)
    meshes = _parse_meshes(file, text)
    if meshes is not None and reverse:
        meshes = meshes[1], meshes[0]
    return replace(Markers.from_pairs(pairs, names if any(names) else ()), meshes=meshes)


def write_markers(path: PathLike, markers: Markers) -> None:
    """Write markers in the form that the file's extension selects; see ``docs/transfer.md``."""
    file = Path(path)
    names = [" ".join(name.split()) for name in markers.names or [""] * len(markers)]
    rows = list(zip(markers.source.tolist(), markers.target.tolist(), names, strict=True))
    comments = [f"  # {name}" if name else "" for name in names]
    meshes = markers.meshes and json.dumps(
        {side: vars(mesh) for side, mesh in zip(_SIDES, markers.meshes, strict=True)}
    )
    note = f"# meshes {meshes}\n" if meshes else ""
    if file.suffix.lower() == ".json":
        objects = [{"source": s, "target": t} | ({"name": name} if name else {}) for s, t, name in rows]
        body = ",\n".join(f"  {json.dumps(marker, ensure_ascii=False)}" for marker in objects)
        more = f',\n"meshes": {meshes}' if meshes else ""
        text = f'{{"markers": [\n{body}\n]{more}}}\n'
    elif file.suffix.lower() in YAML_EXTENSIONS:
        lines = (f'  - "{s}:{t}"{comment}\n' for (s, t, _), comment in zip(rows, comments, strict=True))
        text = f"{note}markers:\n" + "".join(lines)
    else:
        lines = (f"{s} {t}{comment}\n" for (s, t, _), comment in zip(rows, comments, strict=True))
        text = f"# source target\n{note}" + "".join(lines)
    with atomic_file(file) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _parse_meshes(file: Path, text: str) -> tuple[NumberedVertices, NumberedVertices] | None:
    """Return what finds the vertices of source and target in other files, or None if the file has nothing about it."""
    if file.suffix.lower() == ".json":
        tree = parse_json(file, text)
        stored = tree.get("meshes") if isinstance(tree, dict) else None
    else:
        note = _MESHES_PATTERN.search(text)
        stored = note and parse_json(file, note[1])
    if stored is None:
        return None
    from mixseq.compression.numbering import NumberedVertices  # imports numba

    try:
        source, target = (
            NumberedVertices(
                str(stored[side]["checksum"]),
                str(stored[side]["walk_checksum"]),
                {int(vertex): int(walk_id) for vertex, walk_id in stored[side]["walk_ids"].items()},
            )
            for side in _SIDES
        )
    except (LookupError, TypeError, ValueError, AttributeError):
        raise FormatError(
            f"{file}: 'meshes' is damaged; delete it if vertices have the numbers of the meshes"
        ) from None
    return source, target


def _parse_lines(file: Path, text: str) -> _RawMarkers:
    markers: _RawMarkers = []
    expected_count = None
    for number, line in enumerate(text.splitlines(), start=1):
        value, _, comment = line.partition("#")
        value = value.strip()
        is_first = not markers and expected_count is None
        if is_first and _COUNT_PATTERN.fullmatch(value):
            expected_count = int(value)
        elif value and not (is_first and _HEADING_PATTERN.fullmatch(value)):
            markers.append((f"line {number}", value, comment))
    if expected_count is not None and expected_count != len(markers):
        raise FormatError(
            f"{file}: its first line announces {expected_count} markers, but {len(markers)} follow; "
            "is it truncated? If not, leave that line out"
        )
    return markers


def _parse_yaml(file: Path, text: str) -> _RawMarkers:
    """Return unvalidated markers of YAML, named by comments; numbers stay text, as YAML reads ``12:34`` as a time."""
    try:
        import yaml
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            f"{file}: markers in YAML need PyYAML; get it with: pip install 'mixseq[yaml]'"
        ) from error
    try:
        for token in yaml.scan(text, Loader=yaml.SafeLoader):
            # A few lines of nested aliases can expand beyond any memory.
            if isinstance(token, yaml.AnchorToken | yaml.AliasToken):
                line = token.start_mark.line + 1
                raise FormatError(f"{file}, line {line}: anchors (&) and aliases (*) are not read; write it out")
        loader = yaml.BaseLoader(text)  # keeps numbers as text
        root = loader.get_single_node()
        values = _find_list(file, loader.construct_document(root) if root else None)
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or summarize_error(error)
        line = f", line {mark.line + 1}" if mark else ""
        raise FormatError(f"{file}{line} cannot be read as YAML: {problem}") from None
    nodes = root
    if isinstance(root, yaml.MappingNode):
        nodes = next((value for key, value in root.value if key.value == "markers"), None)
    if not isinstance(nodes, yaml.SequenceNode):  # separate lists of sources and of targets
        return [(f"marker {number}", value, "") for number, value in enumerate(values, start=1)]
    lines = text.splitlines()
    markers: _RawMarkers = []
    for node, value in zip(nodes.value, values, strict=True):
        end = node.end_mark
        rest = lines[end.line][end.column :] if end.line == node.start_mark.line else ""
        markers.append((f"line {node.start_mark.line + 1}", value, rest.partition("#")[2]))
    return markers


def _find_list(file: Path, tree: Any) -> list[Any]:
    """Find the list of markers in the parsed contents of a file."""
    if isinstance(tree, dict) and "markers" in tree:
        tree = tree["markers"]
    elif isinstance(tree, dict) and isinstance(tree.get("source"), list):
        columns = [tree["source"], tree.get("target"), tree.get("names")]
        if columns[2] is None:
            columns[2] = [""] * len(columns[0])
        lengths = [len(column) if isinstance(column, list) else -1 for column in columns]
        if len(set(lengths)) != 1:
            raise FormatError(f"{file}: its lists 'source', 'target' (and 'names') are not equally long")
        keys = ("source", "target", "name")
        tree = [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)]
    if not isinstance(tree, list):
        raise FormatError(
            f"{file} has no list of markers; a list of pairs is expected, by itself or as 'markers', or lists "
            "'source' and 'target'"
        )
    return tree


def _parse_marker(where: str, value: Any, name: str) -> tuple[int, int, str]:
    """Return the source vertex, target vertex and name of one marker."""
    if isinstance(value, str):
        match = _PAIR_PATTERN.fullmatch(value.strip())
        if match is None:
            raise FormatError(f"{where}: {_quote(value)} is not a pair of vertices; {_PAIR_TEXT}")
        value = match.groups()
    elif isinstance(value, dict):
        name = str(value.get("name") or name)
        value = [value.get("source"), value.get("target")]
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise FormatError(
            f"{where}: {_quote(value)} is not a marker; a pair of vertices, a text such as '750:3386', or an object "
            "with 'source' and 'target' is expected"
        )
    source, target = (_parse_vertex(where, number) for number in value)
    return source, target, " ".join(name.split())


def _parse_vertex(where: str, value: Any) -> int:
    if isinstance(value, str) and _COUNT_PATTERN.fullmatch(value.strip()):
        return int(value)
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 62:
        return value
    raise FormatError(f"{where}: {_quote(value)} is not a vertex number; vertices are numbered from 0")


def _quote(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:36]}..."
