"""The demo in a terminal: a table that lives; in a log a line now and then."""

import asyncio
import io

import pytest
from rich.console import Console
from rich.table import Table

from valvemap.cli.demo import _View
from valvemap.cli.demo_stage import _watch
from valvemap.cli.rig_conditions import condition_line
from valvemap.model.forgetting import Exponential
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.valve_state import ValvePlan
from valvemap_rig.condition import condition
from valvemap_rig.faults import commanded_fault
from valvemap_rig.scenario import BUILTIN
from valvemap_rig.simulation import Commands, advance, initial


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


@pytest.fixture(scope="module")
def view():
    scenario = BUILTIN["demo"]
    plan = ValvePlan(
        name="Valvistor",
        gate=QualityGate(),
        estimators={"RLS": RecursiveLeastSquares(forgetting=Exponential(0.99))},
        inverse="RLS",
    )
    identification = Identification([plan], Alignment(AlignmentSettings(), optional=(("T",),)))
    return _View(identification, scenario)


def played(view, state, commands=None):
    """Identify ten seconds of a rig, and hear what has become of it."""
    scenario = BUILTIN["demo"]
    state, block = advance(scenario, state, 1_000, commands)
    valve = block.valves["Valvistor"]
    columns = {name: getattr(valve, name) for name in ("U", "p1", "p2", "Q", "T")}
    view.identification.take_samples(0, Samples.of(t=valve.t, **columns))
    faults = state.valves["Valvistor"].faults
    view.follow(condition_line({"Valvistor": condition(faults, state.index - 1, 100.0)}))
    (verdict,) = view.verdicts()
    return state, verdict.rmse["RLS"]


def test_the_error_shown_is_that_against_the_valve_as_it_is(view):
    state, new = played(view, initial(BUILTIN["demo"], 1_800_000_000_000_000_000))
    damage = Commands(faults=(("Valvistor", commanded_fault("damage", 12.0, 0.0)),))
    _, damaged = played(view, state, damage)
    assert damaged == pytest.approx(new, rel=0.3)  # against the new valve: 11 l/min
    assert damaged < 3.0


@pytest.mark.parametrize("line", ["", "{}", "[1]", '{"V9": [1, 0, 0]}', '{"Valvistor": "x"}'])
def test_a_line_that_says_nothing_of_the_valve_changes_nothing(view, line):
    before = view.lines()
    view.follow(line)
    assert view.lines() == before
