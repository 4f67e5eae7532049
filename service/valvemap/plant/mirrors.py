"""Valves whose signals are those of another one once more, as on a display or in an archive."""

from collections.abc import Iterator, Mapping, Sequence

from valvemap.foreign_text import printable
from valvemap.plant.possible import copied
from valvemap.plant.reading import Reading, Record
from valvemap.plant.roles import Role
from valvemap.plant.verdict import Verdict


def mirrors(verdicts: Sequence[Verdict], records: Mapping[str, Record]) -> Iterator[str]:
    """Yield a line for each accepted valve whose signals are all copies of an earlier one's."""
    accepted = [one for one in verdicts if one.question is None and one.reading is not None]
    for number, one in enumerate(accepted):
        for other in accepted[:number]:
            if _is_mirror(one.reading, other.reading, records[one.valve]):
                valve = printable(one.valve)
                yield (
                    f"{valve}: all its values are those of {printable(other.valve)}; is it the "
                    f"same valve? --skip={valve} leaves it out"
                )
                break


def _is_mirror(reading: Reading | None, other: Reading | None, record: Record) -> bool:
    if reading is None or other is None or not reading.fit.moves:
        return False
    own = {role: node for role, node in reading.nodes.items() if role is not Role.T}
    nodes = other.nodes
    return own.keys() <= nodes.keys() and all(
        node.node == nodes[role].node or copied(node, record, [nodes[role]]) is not None
        for role, node in own.items()
    )
