"""Long work says how far it has come to who watches, and nothing to a log."""

import io
from pathlib import Path

import pytest
from rich.console import Console

from valvemap.cli import progress


@pytest.fixture
def watched(monkeypatch):
    """The error stream as a terminal, and as a file."""
    shown = {}

    def console(*, terminal):
        out = io.StringIO()
        made = Console(file=out, force_terminal=terminal, width=100)
        monkeypatch.setattr(progress, "terminal", lambda **_: made)
        shown["text"] = out.getvalue
        return shown

    return console


@pytest.mark.parametrize("terminal", [True, False])
def test_a_file_that_is_read_has_a_bar_on_a_terminal(watched, terminal):
    shown = watched(terminal=terminal)
    with progress.bars() as bars:
        update = progress.of_files(bars)
        update(Path("folder/plant.csv"), 0.0)
        update(Path("folder/plant.csv"), 1.0)
    assert ("plant.csv" in shown["text"]()) is terminal
    assert ("100%" in shown["text"]()) is terminal


@pytest.mark.parametrize("terminal", [True, False])
def test_work_without_a_known_end_has_a_line_that_goes_away(watched, terminal):
    shown = watched(terminal=terminal)
    with progress.working("compiling") as say:
        say("still compiling")
    assert ("compiling" in shown["text"]()) is terminal
