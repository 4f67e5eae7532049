"""Reading many variables, some at a time."""

from collections.abc import Sequence

from valvemap.page.ports import Client
from valvemap.readings import Reading

_NODES_AT_ONCE = 200  # of one read: answers stay well within what is decoded of one


async def read_all(client: Client, ids: Sequence[str | int]) -> list[Reading]:
    """Values of variables, one reading each."""
    readings: list[Reading] = []
    for start in range(0, len(ids), _NODES_AT_ONCE):
        readings += await client.read(ids[start : start + _NODES_AT_ONCE])
    return readings
