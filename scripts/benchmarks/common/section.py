"""What a measurement shows: tables, targets that are met or not, notes. It goes to JSON and back, and to Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

Say = Callable[[str], None]
"""Told how far a measurement is, in one line."""


@dataclass(frozen=True)
class Target:
    """A figure and what it should be, at least or at most."""

    what: str
    value: float
    target: float
    unit: str
    least: bool

    @property
    def met(self) -> bool:
        return self.value >= self.target if self.least else self.value <= self.target

    def row(self) -> tuple[str, ...]:
        bound = f"{'>=' if self.least else '<='} {self.target:g}{self.unit}"
        return self.what, f"{self.value:.3g}{self.unit}", bound, "met" if self.met else "**not met**"


def at_least(what: str, value: float, target: float, unit: str = "") -> Target:
    """A figure that should not be below its target."""
    return Target(what, float(value), target, unit, True)


def at_most(what: str, value: float, target: float, unit: str = "") -> Target:
    """A figure that should not be above its target."""
    return Target(what, float(value), target, unit, False)


@dataclass(frozen=True)
class Table:
    """A table of text."""

    caption: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


@dataclass(frozen=True)
class Bar:
    """A ratio for the plot, with its target."""

    label: str
    value: float
    target: float


@dataclass(frozen=True)
class Line:
    """A line of points for the plot: cost of a vertex against the number of vertices."""

    label: str
    points: list[tuple[float, float]]


@dataclass(frozen=True)
class Section:
    """All that one measurement shows; the lists are filled as it goes."""

    title: str
    tables: list[Table] = field(default_factory=list)
    targets: list[Target] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    bars: list[Bar] = field(default_factory=list)
    lines: list[Line] = field(default_factory=list)
    figures: list[dict[str, Any]] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        plain = asdict(self)
        for target, row in zip(self.targets, plain["targets"], strict=True):
            row["met"] = target.met
        return plain

    @classmethod
    def from_dict(cls, plain: dict[str, Any]) -> Section:
        targets = [{k: v for k, v in target.items() if k != "met"} for target in plain["targets"]]
        return cls(
            title=plain["title"],
            tables=[Table(t["caption"], tuple(t["columns"]), [tuple(r) for r in t["rows"]]) for t in plain["tables"]],
            targets=[Target(**target) for target in targets],
            notes=plain["notes"],
            bars=[Bar(**bar) for bar in plain["bars"]],
            lines=[Line(line["label"], [tuple(p) for p in line["points"]]) for line in plain["lines"]],
            figures=plain["figures"],
        )

    def markdown(self) -> str:
        """Return a chapter: tables, targets, notes."""
        blocks = [f"### {self.title}"]
        for table in self.tables:
            blocks += [table.caption] * bool(table.caption) + [markdown_table(table.columns, table.rows)]
        if self.targets:
            rows = [target.row() for target in self.targets]
            blocks.append(markdown_table(("target", "measured", "required", ""), rows))
        return "\n\n".join([*blocks, *self.notes])


def markdown_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
