"""Vertex animation textures on the command line."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mixseq.errors import SettingsError

if TYPE_CHECKING:
    from mixseq_io.vat.writer import VatReport


def check_textures(others: Mapping[str, Any]) -> None:
    """Raise an error for options, by name, that textures do not support; None and False are not given."""
    for name, value in others.items():
        if value is not None and value is not False:
            option = f"--{name.replace('_', '-')}"
            raise SettingsError(f"vertex animation textures (.vat) have no place for {option}; leave it out")


def texture_rows(report: VatReport) -> list[tuple[str, str]]:
    """Return table rows of the textures' sizes and errors."""
    from mixseq.cli.console import format_bytes

    kind = report.kind if not report.rank else f"{report.kind}, {report.rank} basis vectors"
    return [
        (
            "textures",
            f"{kind}: {format_bytes(report.file_bytes)}, in memory {format_bytes(report.memory_bytes)}",
        ),
        ("max error", f"{report.max_error:.4g} diagonals"),
        ("rms error", f"{report.rms_error:.4g} diagonals"),
        ("normals", f"off by {report.normal_degrees:.3g} degrees (root mean square)"),
    ]
