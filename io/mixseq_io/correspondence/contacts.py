"""Files of contacts: named groups of vertices of a target that rest on the ground, such as feet.

JSON, ``{"left foot": [12, 13, 20], "right foot": [40, 41]}``, with vertices numbered from 0; or an object with that as
``"contacts"``.
"""

from __future__ import annotations

from pathlib import Path

from mixseq.arrays import PathLike
from mixseq.errors import FormatError
from mixseq_io.correspondence.text_files import parse_json, read_text


def read_contacts(path: PathLike) -> dict[str, list[int]]:
    """Read contacts.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "feet.json")
    ...     _ = file.write_text('{"left": [3, 4], "right": [7]}')
    ...     read_contacts(file)
    {'left': [3, 4], 'right': [7]}
    """
    file = Path(path)
    groups = parse_json(file, read_text(file, "contacts"))
    if isinstance(groups, dict) and isinstance(groups.get("contacts"), dict):
        groups = groups["contacts"]
    if not isinstance(groups, dict) or not groups:
        raise FormatError(f'{file} has no contacts; an object such as {{"left foot": [12, 13]}} is expected')
    for name, vertices in groups.items():
        if not isinstance(vertices, list) or not vertices:
            raise FormatError(
                f"{file}: contact '{name}' is no list of vertices; give at least one number, from 0"
            )
        wrong = [vertex for vertex in vertices if type(vertex) is not int or vertex < 0]
        if wrong:
            raise FormatError(
                f"{file}: contact '{name}' names {wrong[0]!r}, which is no vertex; they count from 0"
            )
    return groups
