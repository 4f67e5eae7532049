"""A reload of the configuration: one configuration of a process ends, and the next one begins."""

import asyncio
from typing import Final

from simulation import judge
from valvemap.runtime.transferred_states import transfer

_SHARP: Final = 0.5  # share of the reloads that come with a message
_LONGEST_S: Final = 6.0  # until that message
_TURNS: Final = 6  # of the event loop, behind it


async def reload(world, live, sources, stop, supervising):
    """End one configuration as the service does; the world's next life takes over from it."""
    if world.rng.random() < _SHARP:
        await asyncio.sleep(min(world.rng.choice(sources.parts).source.due_s, _LONGEST_S))
        for _ in range(world.rng.randrange(_TURNS)):
            await asyncio.sleep(0.0)
    following = world.connect()
    following.succeed(sources)
    if world.axes is not None:
        world.axes.reload()
    stop.set()
    await supervising
    if world.axes is not None:
        await world.axes.transfer()
    await transfer(live.keeper, live.keep, world.transferred)
    world.all_saved, world.delivering = True, set()
    judge.of_counts(world, live.identification)
    world.reloaded = following
