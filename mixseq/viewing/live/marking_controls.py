"""The panel for setting markers, beside the two meshes."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from typing import Any

import numpy as np

from mixseq.correspondence.examination import FEWEST, Examination
from mixseq.viewing.live.marking_stage import colour
from mixseq.viewing.marking import Marking
from mixseq.viewing.marking_session import MarkingSession

VIEWS = {
    "Front": (0.0, 5.0),
    "Left": (90.0, 5.0),
    "Right": (-90.0, 5.0),
    "Back": (180.0, 5.0),
    "Above": (90.0, 80.0),
    "Below": (90.0, -80.0),
}
"""Views of both meshes: degrees from the front of the first, to its left, and above the horizon."""

LISTED = 5
"""Number of listed markers, those of largest residuals."""


class MarkingControls:
    """Undo, proposals, examination of the map, and saving."""

    def __init__(
        self,
        server: Any,
        session: MarkingSession,
        names: tuple[str, str],
        file: str,
        look: Callable[[tuple[float, float]], None],
        other: Callable[[Any], None],
        save: Callable[[], None],
    ) -> None:
        gui = server.gui
        self._session = session
        self._names = names
        self._file = file
        with gui.add_folder("Markers"):
            self._hint = gui.add_html("")
            steps = gui.add_button_group("Steps", ("Undo", "Redo", "Delete"))
            views = gui.add_button_group("See from", tuple(VIEWS))
            across = gui.add_button("Other mesh", hint="Look at the same place of the other mesh (key O)")
        with gui.add_folder("Proposed"):
            self._proposed = gui.add_html("")
            proposals = gui.add_button_group("", ("Accept", "Skip", "Accept all"))
            again = gui.add_button("Suggest", hint="Look for tips of limbs, tail, nose and ears")
        with gui.add_folder("Map"):
            self._map = gui.add_html("")
        with gui.add_folder("Save"):
            self._saved = gui.add_html("")
            button = gui.add_button("Save")
        steps.on_click(lambda _: getattr(session, steps.value.lower())())
        views.on_click(lambda _: look(VIEWS[views.value]))
        across.on_click(lambda event: other(event.client.camera))
        gui.add_command("Other mesh", hotkey="O").on_trigger(lambda event: other(event.client.camera))
        does = {"Accept": session.accept, "Skip": session.skip, "Accept all": session.accept_all}
        proposals.on_click(lambda _: does[proposals.value]())
        again.on_click(lambda _: session.suggest())
        button.on_click(lambda _: save())
        for label, key, modifier, action in (
            ("Undo", "Z", "cmd/ctrl", session.undo),
            ("Redo", "Z", "cmd/ctrl+shift", session.redo),
            ("Accept", "A", None, session.accept),
            ("Skip", "S", None, session.skip),
            ("Delete", "D", None, session.delete),
        ):
            command = gui.add_command(label, hotkey=key, modifier=modifier)
            command.on_trigger(lambda _, act=action: act())

    def show(self) -> None:
        """Show the current markers and their examination."""
        session = self._session
        marking, proposals, examination = session.marking, session.proposals, session.examination
        self._hint.content = _lines("mixseq-hint", [_hint(marking, self._names)])
        self._proposed.content = _lines("mixseq-proposed", [_proposed(len(proposals), session.work)])
        self._map.content = _lines("mixseq-map", _map_lines(marking, examination, session.work))
        state = "changed since it was saved" if session.unsaved else "as in the file"
        self._saved.content = _lines("mixseq-saved", [escape(f"{self._file}: {state}")])


def _hint(marking: Marking, names: tuple[str, str]) -> str:
    count = len(marking.pairs)
    done = f"{count} pair{'' if count == 1 else 's'}. "
    if marking.chosen is not None:
        text = f"{_number(marking.chosen)} is chosen: click where it should be on either mesh, or Delete"
    elif marking.begun is None:
        text = (
            f"Click a point of {escape(names[0])} or {escape(names[1])}; click a number to move or delete it"
        )
    else:
        other = names[1 - marking.begun[0]]
        text = f"{_number(count)}: now click the same point of {escape(other)}"
    return done + text


def _proposed(count: int, work: str) -> str:
    if count:
        return f"{count} to confirm, dark in the picture: the next one has a ?. Click one to accept it"
    return (
        escape(f"{work} ...")
        if "look" in work
        else "Nothing: the other side of what you set is proposed here"
    )


def _map_lines(marking: Marking, examination: Examination | None, work: str) -> list[str]:
    count = len(marking.pairs)
    if examination is None:
        return [escape(f"{work} ...") if work else ""]
    lines = []
    if examination.residuals is not None:
        percent = 100 * examination.residuals
        worst = np.argsort(-percent, kind="stable")[:LISTED]
        listed = ", ".join(f"{_number(int(number))} {percent[number]:.1f} %" for number in worst)
        lines = [
            f"markers are off by {np.median(percent):.1f} % of the diagonal (median) where a stiff map takes them, "
            f"{percent.max():.1f} % at most",
            f"most: {listed}",
            f"{100 * examination.coverage:.0f} % of the target covered",
        ]
    elif examination.refusal:
        lines = [escape(examination.refusal)]
    elif count < FEWEST:
        lines = [f"tells how well pairs fit, from {FEWEST} on"]
    suspects = [f'<span style="color: #c92a2a">{escape(each.why)}</span>' for each in examination.suspicions]
    return lines + suspects


def _number(number: int) -> str:
    red, green, blue = colour(number)
    return f'<b style="color: rgb({red} {green} {blue})">{number + 1}</b>'


def _lines(name: str, lines: list[str]) -> str:
    inside = "".join(f"<div>{line}</div>" for line in lines)
    return f'<div id="{name}" style="padding: 2px 12px; font-size: 12px">{inside}</div>'
