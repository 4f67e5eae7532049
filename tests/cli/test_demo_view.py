"""The demo in a terminal: a table that lives; in a log a line now and then."""

import asyncio
import io

from rich.console import Console
from rich.table import Table

from valvemap.cli.demo import _watch


class Counting:
    """Shows how often it was looked at."""

    def __init__(self):
        self.looks = 0

    def table(self):
        self.looks += 1
        table = Table(title="live")
        table.add_column("look")
        table.add_row(f"look {self.looks}")
        return table

    def lines(self):
        self.looks += 1
        return [f"line {self.looks}"]


async def watched(*, terminal, duration):
    out, view = io.StringIO(), Counting()
    console = Console(file=out, force_terminal=terminal, width=80)
    serving = asyncio.get_running_loop().create_future()
    await _watch(view, console, asyncio.Event(), serving, duration)
    return out.getvalue(), view.looks


async def test_on_a_terminal_the_table_is_drawn_anew_every_second_in_its_place():
    shown, looks = await watched(terminal=True, duration=2.5)
    assert looks >= 2
    assert "look 1" in shown
    assert "look 2" in shown
    assert "\x1b[1A" in shown  # up again: the newer table takes the place of the older


async def test_in_a_log_there_are_lines_and_no_table():
    shown, _ = await watched(terminal=False, duration=0.2)
    assert "look" not in shown
    assert "\x1b" not in shown
