"""Reads many variables in batches."""

from collections.abc import Sequence

from valvemap.page.ports import Client
from valvemap.readings import Reading

_NODES_AT_ONCE = 200  # nodes of one read: keeps responses well below the decoding limit


async def read_all(client: Client, ids: Sequence[str | int]) -> list[Reading]:
    """Read variables; return one reading each."""
    readings: list[Reading] = []
    for start in range(0, len(ids), _NODES_AT_ONCE):
        readings += await client.read(ids[start : start + _NODES_AT_ONCE])
    return readings
