"""What ``valvemap connect`` prints: the values seen, the sheet, omitted variables, questions."""

import shlex
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from valvemap.foreign_text import printable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from valvemap.app.connect import Found
    from valvemap.plant.verdict import Verdict

_MOST_SKIPPED = 20  # lines; further ones are counted only


def of_valves(found: "Found", command: str) -> "Iterator[str]":
    """Yield the lines of the sheet, and of the questions; ``command`` is the one that asks."""
    yield from _sheet(found)
    for verdict in found.open:
        yield from _question(verdict, command)


def _question(verdict: "Verdict", command: str) -> "Iterator[str]":
    """Yield the lines of a question: the readings, their consequences, and the command of each."""
    question = verdict.question
    if question is None:
        return
    yield f"{verdict.valve}: {question.about}"
    if verdict.reading is not None:
        for role, node in verdict.reading.nodes.items():
            yield f"  {role:8} {printable(node.node)}"
    for number, option in enumerate(question.options, 1):
        yield f"  {number}. {option.text} ({100 * option.probability:.0f} %)"
        yield f"     {option.consequence}"
        yield f"     answer: {command} {' '.join(map(shlex.quote, option.answers))}"
    if question.otherwise:
        spans = " ".join(question.otherwise)
        yield f"  if a sensor has another span, LEAST to MOST: {command} {spans}"
    if not question.options and verdict.reading is not None and verdict.reading.missing:
        wanted = (f"--signal={verdict.valve}.{role}=NODE" for role in verdict.reading.missing)
        yield f"  to name what is missing: {command} {' '.join(wanted)}"
    yield f"  to leave it out: {command} --skip={verdict.valve}"


def _sheet(found: "Found") -> "Iterator[str]":
    """Yield the lines of the sheet; a NodeId is on one line, so that it can be copied."""
    from valvemap.app.sheet import rows

    valve = None
    for row in rows(found.accepted):
        if row.valve != valve:
            valve = row.valve
            yield f"Signals of {printable(valve)}"
        yield f"  {row.signal:8} {row.node}".rstrip()
        bounds = row.range and f"range {row.range}"
        seen = row.seen and f"seen {row.seen}"
        yield f"           {'; '.join(filter(None, (row.unit, bounds, seen, row.reason)))}"


def left_out(found: "Found") -> "Iterator[str]":
    """Yield lines for unusable nodes, and for numbers of no valve; the first of each."""
    from valvemap.plant.unused import of_others, of_signals

    yield from (f"skipped: {line}" for line in _first(found.skipped))
    yield from (f"note: {line}" for line in _first(found.notes))
    yield from (f"not used: {line}" for line in _first(list(of_signals(found.unused))))
    yield from (f"not used: {line}" for line in of_others(found.unused))


def table(found: "Found") -> Table:
    """Table of the values seen; it fits a terminal of 80 columns."""
    shown = Table(title="Values seen", title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    shown.add_column("signal", no_wrap=True)
    for heading in ("rate\nHz", "skew\nms", "comes", "good\n%", "mean", "noise"):
        shown.add_column(heading, justify="right", no_wrap=True)
    for verdict in found.verdicts:
        if verdict.reading is None:
            continue
        shown.add_row(Text(printable(verdict.valve), style="bold"))
        for role, node in verdict.reading.nodes.items():
            seen = found.watched.get(verdict.valve, {}).get(node.node)
            figures: list[str] = []
            if seen is not None:
                comes = "on change" if seen.on_change else "cyclic"
                numbers = seen.rate_hz, seen.skew_ms, 100.0 * seen.good, seen.mean, seen.noise
                rate, skew, good, mean, noise = (f"{number:.3g}" for number in numbers)
                figures = [rate, skew, comes, good, mean, noise]
            shown.add_row(role, *figures)
    return shown


def _first(found: "Sequence[str]") -> list[str]:
    more = len(found) - _MOST_SKIPPED
    return [*found[:_MOST_SKIPPED], *([f"{more:,} more"] if more > 0 else [])]
