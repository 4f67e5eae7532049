"""Batches of a simulated service that others overtake."""

import asyncio

from valvemap.vocabulary.signals import PER_VALVE

_SHARPEST_S = 6.0  # how long a kill waits for the moment at which it hurts most
_SHARP_S = 0.1


class Overtaken:
    """The batches under way, of which states were saved after another batch had overtaken one."""

    def __init__(self, live, states):
        self._states, self._batches = states, {}  # by valves: changes left, saves when overtaken
        take, learn = live.take, live.identification.take

        async def noted(changes, valves):
            own = tuple(valves.tolist())
            self._batches[own] = len(changes), None
            try:
                await take(changes, valves)
            finally:
                del self._batches[own]
                for other, (left, saves) in self._batches.items():
                    now = states.saves if saves is None else saves
                    self._batches[other] = left, now

        def learning(piece):
            for own, (left, saves) in self._batches.items():
                if piece.item[0] // PER_VALVE in own:
                    self._batches[own] = left - len(piece), saves
            return learn(piece)

        live.take, live.identification.take = noted, learning

    def was_overtaken(self):
        return any(
            left and saves is not None and self._states.saves > saves
            for left, saves in self._batches.values()
        )

    async def wait(self):
        """Wait for the worst moment of a kill: states were just saved, and a batch is half done."""
        for _ in range(round(_SHARPEST_S / _SHARP_S)):
            if self.was_overtaken():
                return
            await asyncio.sleep(_SHARP_S)
