"""What a source has sent until now."""

import asyncio


async def until(source, wanted):
    """The newest value of each item, once those wanted have come."""
    found = {}
    async with asyncio.timeout(20):
        while not wanted.items() <= found.items():
            changes = await source.receive()
            found |= dict(zip(changes.item.tolist(), changes.value.tolist(), strict=True))
    return found
