"""What was done, undone, and done again."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from mixseq.signals.model import Model
from mixseq.viewer.session import History


def test_a_model_to_which_nothing_was_done(bar_model: Model) -> None:
    history = History.of(bar_model)
    assert history.model is bar_model
    assert (history.changed, history.undoes, history.redoes) == (False, None, None)
    assert history.undone().model is bar_model
    assert history.redone().model is bar_model


def test_an_edit_is_undone_and_done_again(bar_model: Model) -> None:
    once, twice = replace(bar_model), replace(bar_model)
    history = History.of(bar_model).done("cut", once).done("loop", twice)
    assert (history.model, history.undoes, history.redoes) == (twice, "loop", None)
    back = history.undone()
    assert (back.model, back.undoes, back.redoes, back.changed) == (once, "cut", "loop", True)
    assert back.redone().model is twice
    assert history.model is twice  # it is what it was
    assert not back.undone().changed


def test_what_was_undone_is_gone_after_another_edit(bar_model: Model) -> None:
    other = replace(bar_model)
    history = History.of(bar_model).done("cut", replace(bar_model)).undone().done("loop", other)
    assert (history.model, history.undoes, history.redoes) == (other, "loop", None)
    assert [step.name for step in history.steps] == ["", "loop"]


@given(st.lists(st.sampled_from(["do", "undo", "redo"]), max_size=30))
def test_as_two_stacks(bar_model: Model, actions: list[str]) -> None:
    history, done, undone = History.of(bar_model), [bar_model], list[Model]()
    for action in actions:
        if action == "do":
            done.append(replace(bar_model))
            undone.clear()
            history = history.done("edit", done[-1])
        elif action == "undo":
            if len(done) > 1:
                undone.append(done.pop())
            history = history.undone()
        else:
            if undone:
                done.append(undone.pop())
            history = history.redone()
        assert history.model is done[-1]
        assert history.changed == (len(done) > 1)
        assert (history.undoes is None, history.redoes is None) == (len(done) == 1, not undone)
