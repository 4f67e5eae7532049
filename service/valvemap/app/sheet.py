"""The sheet with which `connect` ends: signal, node, unit, range, values seen, and reason."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from html import escape

import numpy as np

from valvemap.foreign_text import printable
from valvemap.plant.evidence import coefficient
from valvemap.plant.ports import NAMES, physics_of
from valvemap.plant.reading import Reading
from valvemap.plant.roles import QUANTITY, Role
from valvemap.plant.unused import Unused
from valvemap.plant.verdict import Verdict

HEADINGS = ("signal", "node", "unit", "range", "values seen", "reason")


@dataclass(frozen=True)
class Row:
    """One signal of a valve; texts are printable."""

    valve: str
    signal: str
    node: str
    unit: str
    range: str
    seen: str
    reason: str

    @property
    def cells(self) -> tuple[str, ...]:
        """The cells under :data:`HEADINGS`."""
        return self.signal, self.node, self.unit, self.range, self.seen, self.reason


def rows(verdicts: Iterable[Verdict]) -> Iterator[Row]:
    """Yield the rows of the accepted valves, and of the signals recognised beside them."""
    for verdict in verdicts:
        reading = verdict.reading
        if reading is None or verdict.question is not None:
            continue
        for role in reading.nodes:
            yield _row(verdict, reading, role)
        for edge, law in verdict.edges.items():
            yield Row(verdict.valve, f"edge {edge}", "", "", "", "", physics_of(edge, law))
        for node, role in verdict.others.items():
            yield Row(verdict.valve, "-", printable(node), "", "", "", f"not used: {role}")


def _row(verdict: Verdict, reading: Reading, role: Role) -> Row:
    node, scale = reading.nodes[role], reading.scales[role]
    own = QUANTITY[role].value
    name = NAMES[role] if verdict.has_ports else str(role)
    good = reading.values[role][np.isfinite(reading.values[role])]
    seen = f"{good.min():.4g} … {good.max():.4g} {own}" if len(good) else "none"
    reasons = [f"name {printable(node.path[-1])}", scale.reason]
    if reading.fit.moves and role is not Role.T:
        reasons.append(f"orifice law explains {100 * reading.fit.explained:.0f} % of Q")
    elif role is Role.Q and not verdict.has_ports:
        reasons.append("not checked by the orifice law: Q did not move")
    if role is Role.Q and not verdict.has_ports and not verdict.rating.flow_l_min:
        reasons += _unrated(reading, verdict.rating.drop_bar)
    bounds = "" if node.bounds is None else f"{node.bounds[0]:g} … {node.bounds[1]:g}"
    return Row(
        verdict.valve, name, printable(node.node), scale.text or own, bounds, seen,
        "; ".join(reasons),
    )  # fmt: skip


def _left_out(one: Unused) -> Row:
    node = one.variable
    bounds = "" if node.bounds is None else f"{node.bounds[0]:g} … {node.bounds[1]:g}"
    name = printable("/".join(node.path))
    unit = printable(node.symbol) or "/".join(unit.symbol for unit in node.label.units)
    return Row(
        "Used by no valve", "-", printable(node.node), unit, bounds, "", f"{name}: {one.reason}"
    )  # fmt: skip


def _unrated(reading: Reading, drop_bar: float) -> Iterator[str]:
    """Yield what to compare with the name plate: a factor of Q contradicts nothing else."""
    k, U = coefficient(reading.values), np.abs(reading.values[Role.U])
    if reading.fit.moves and k > 0.0 and np.isfinite(U).any():
        yield (
            f"its factor is not checked: compare {k * drop_bar**0.5:.3g} l/min at {drop_bar:g} bar "
            f"and U = {np.nanmax(U):.0f} % with the name plate, or give --rated-flow"
        )


def sheet_page(url: str, verdicts: Iterable[Verdict], left: Iterable[Unused] = ()) -> str:
    """Return the sheet as a page (HTML, complete in itself) with a line for a signature.

    The numbers ``left`` that no valve uses are at its end, each with the reason.
    """
    body: list[str] = []
    valve = None
    for row in (*rows(verdicts), *map(_left_out, left)):
        if row.valve != valve:
            valve = row.valve
            body.append(f'<tr><th colspan="{len(HEADINGS)}">{escape(valve)}</th></tr>')
        body.append(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row.cells)}</tr>")
    head = "".join(f"<th>{heading}</th>" for heading in HEADINGS)
    return f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Signals of {escape(printable(url))}</title>
<style>body{{font:14px sans-serif;margin:2em}}table{{border-collapse:collapse}}
td,th{{border:1px solid #999;padding:.3em .6em;text-align:left;vertical-align:top}}</style>
<h1>Signals of {escape(printable(url))}</h1>
<table><thead><tr>{head}</tr></thead><tbody>
{chr(10).join(body)}
</tbody></table>
<p>Checked by: ____________________ Date: ____________ Signature: ____________________</p>
</html>
"""
