"""Checked access to the JSON of a glTF file, and the extensions that it may require."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError

SEQUENCE_EXTENSION = "MIXSEQ_mesh_sequence"
"""Extension of meshes whose frames are streams, see `mixseq_io.gltf.sequence_extension`."""

_UNDERSTOOD = (
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_draco_mesh_compression",
    "KHR_mesh_quantization",
    SEQUENCE_EXTENSION,
)

# They change how a mesh looks, not where it is.
_APPEARANCE = (
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "MSFT_texture_",
    "KHR_lights_",
    "EXT_lights_",
)
_HARMLESS = (
    "KHR_node_visibility",
    "KHR_node_selectability",
    "KHR_node_hoverability",
    "KHR_xmp",
    "KHR_xmp_json_ld",
)


def check_extensions(top: Fields) -> None:
    """Raise an error for files whose meshes need an unsupported extension."""
    for name in top.texts("extensionsRequired"):
        if name not in (*_UNDERSTOOD, *_HARMLESS) and not name.startswith(_APPEARANCE):
            raise FormatError(
                f"{top.file} requires the extension {name[:80]}, which is not read; export without it"
            )


_LARGEST = 2**53  # of the integers that JSON readers agree on


@dataclass(frozen=True)
class Fields:
    """JSON object and its path in the file."""

    file: Path
    place: str
    values: Mapping[str, Any]

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def integer(self, key: str, default: int | None = None) -> int:
        """Return a non-negative integer, required unless there is a default."""
        return self._integer(key, self.values.get(key, default))

    def index(self, key: str) -> int | None:
        """Return an index into another list, None if absent."""
        return self.integer(key) if key in self.values else None

    def text(self, key: str, default: str = "") -> str:
        """Return a string."""
        value = self.values.get(key, default)
        return value if isinstance(value, str) else self._unexpected(key, "a string")

    def flag(self, key: str) -> bool:
        """Return a truth value, False if absent."""
        value = self.values.get(key, False)
        return value if isinstance(value, bool) else self._unexpected(key, "true or false")

    def integers(self, key: str) -> list[int]:
        """Return a list of non-negative integers, empty if absent."""
        return [self._integer(f"{key}[{i}]", value) for i, value in enumerate(self._list(key))]

    def number(self, key: str, default: float) -> float:
        """Return a finite number, the default if absent."""
        value = self.values.get(key, default)
        return float(value) if _is_number(value) else self._unexpected(key, "a finite number")

    def numbers(self, key: str, count: int | None = None) -> NDArray[np.float64] | None:
        """Return a list of `count` finite numbers, None if absent."""
        if key not in self.values:
            return None
        numbers = self._list(key)
        if not all(map(_is_number, numbers)) or count not in (None, len(numbers)):
            self._unexpected(
                key, f"a list of {'finite numbers' if count is None else f'{count} finite numbers'}"
            )
        return np.array(numbers, dtype=np.float64)

    def texts(self, key: str) -> list[str]:
        """Return a list of strings, empty if absent."""
        texts = self._list(key)
        if not all(isinstance(text, str) for text in texts):
            self._unexpected(key, "a list of strings")
        return texts

    def object(self, key: str) -> Fields:
        """Return an object, an empty one if absent."""
        return self._object(key, self.values.get(key, {}))

    def objects(self, key: str) -> list[Fields]:
        """Return a list of objects, empty if absent."""
        return [self._object(f"{key}[{i}]", value) for i, value in enumerate(self._list(key))]

    def error(self, what: str) -> FormatError:
        """Return an error that names this object."""
        return FormatError(f"{self.file}: {self.place} {what}")

    def _list(self, key: str) -> list[Any]:
        value = self.values.get(key, [])
        return value if isinstance(value, list) else self._unexpected(key, "a list")

    def _object(self, place: str, value: Any) -> Fields:
        if not isinstance(value, dict):
            self._unexpected(place, "an object")
        return Fields(self.file, f"{self.place}.{place}".lstrip("."), value)

    def _integer(self, place: str, value: Any) -> int:
        # 3.0 is an integer in JSON.
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < _LARGEST:
            self._unexpected(place, "a non-negative integer")
        return int(value)

    def _unexpected(self, place: str, expected: str) -> Any:
        where = f"{self.place}.{place}".lstrip(".")
        raise FormatError(f"{self.file}: {where} is missing or damaged; {expected} is expected there")


def _is_number(value: Any) -> bool:
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and abs(value) < 1e300
        and isfinite(value)
    )
