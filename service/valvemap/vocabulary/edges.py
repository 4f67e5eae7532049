"""The ports, edges and lines of a valve with two directions, and the names that they give.

An edge joins two ports and opens for one sign of U. A line is where a flow is measured: its two
edges are distinguished by the sign of U. Each edge and each line has its place among the valves
under the name ``<Valve>.<Edge>`` or ``<Valve>.Line<A|B>``.
"""

from enum import StrEnum
from typing import Final, Self

LINES: Final = ("A", "B")


class Edge(StrEnum):
    """An edge: the ports it joins, the sign of U that opens it, its line.

    Attributes
    ----------
    of, to
        Ports upstream and downstream.
    opens
        Sign of U for which it opens.
    line
        The port at which its flow is measured.
    adds
        Sign with which its flow counts in the line: 1 out of the valve, -1 into it.

    Examples
    --------
    >>> Edge.AT.of, Edge.AT.to, Edge.AT.opens, Edge.AT.line, Edge.AT.adds
    ('A', 'T', -1, 'A', -1)
    """

    of: str
    to: str
    opens: int
    line: str
    adds: int

    def __new__(cls, value: str, opens: int = 1) -> Self:
        """Make a member; its name is that of its ports."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.of, member.to = value[0], value[1]
        member.opens = opens
        member.adds = 1 if value[1] in LINES else -1
        member.line = member.to if member.adds > 0 else member.of
        return member

    PA = "PA", 1
    AT = "AT", -1
    PB = "PB", -1
    BT = "BT", 1


EDGES: Final = tuple(str(edge) for edge in Edge)
LINE_PARTS: Final = tuple(f"Line{line}" for line in LINES)
PARTS: Final = (*EDGES, *LINE_PARTS)
"""Second segments of the names of edges and lines; no estimator has such a name."""


def edges_of(line: str) -> tuple[Edge, Edge]:
    """Return the edge by which oil enters a line, and that by which it leaves.

    >>> edges_of("B")
    (<Edge.PB: 'PB'>, <Edge.BT: 'BT'>)
    """
    first, second = (edge for edge in Edge if edge.line == line)
    return first, second


def split_id(id_: str) -> tuple[str, str]:
    """Split a node's id into its valve, edge or line, and the rest.

    >>> split_id("V1.RLS.Status"), split_id("V1.PA.RLS.Status"), split_id("V1.PA")
    (('V1', 'RLS.Status'), ('V1.PA', 'RLS.Status'), ('V1.PA', ''))
    """
    owner, _, rest = id_.partition(".")
    part, _, beyond = rest.partition(".")
    return (f"{owner}.{part}", beyond) if part in PARTS else (owner, rest)
