"""Draws the maps in view, the present and the approved ones, into the store."""

import asyncio
from collections.abc import Callable, Sequence

from valvemap.clock import Clock
from valvemap.errors import CommandRejected
from valvemap.page.close_up import TICK_S
from valvemap.page.layout import Valve
from valvemap.page.ports import Client, Wanted
from valvemap.page.store import Store
from valvemap.page.surface import draw_surface

_EVERY_S = 5.0  # s; drawing a map takes the service some 20 ms


class DrawnMaps:
    """Draws maps as long as they are in view.

    Parameters
    ----------
    client
        Client of the service.
    store
        Receives the surfaces.
    clock
        Their time.
    on_change
        Called after each map.
    """

    def __init__(
        self, client: Client, store: Store, clock: Clock, on_change: Callable[[], None]
    ) -> None:
        self._client, self._store, self._clock = client, store, clock
        self._on_change = on_change
        self._approved: dict[tuple[int, str], str] = {}  # versions of the approved maps drawn

    def forget(self) -> None:
        """Draw all approved maps again, after the set of valves has changed."""
        self._approved.clear()

    async def draw_for_ever(
        self, wanted: Callable[[], Wanted], valves: Callable[[], Sequence[Valve]]
    ) -> None:
        """Draw the maps in view until cancelled.

        Raises
        ------
        SourceLost, SourceRejected
        """
        while True:
            for number, estimator in sorted(wanted().maps):
                name = valves()[number].name
                await self._draw(number, name, estimator)
                await self._draw_approved(number, name, estimator)
            await asyncio.sleep(_EVERY_S if wanted().maps else TICK_S)

    async def _draw(
        self, number: int, name: str, estimator: str, *, approved: bool = False
    ) -> None:
        try:
            surface = await draw_surface(self._client, name, estimator, approved=approved)
        except CommandRejected:
            return  # this estimator has no map yet
        now, kind = self._clock.now(), "Approved" if approved else "Surface"
        for part, matrix in surface.items():
            self._store.put(number, f"{estimator}.{kind}{part}", matrix, 0, now)
        self._on_change()

    async def _draw_approved(self, number: int, name: str, estimator: str) -> None:
        """Draw the approved map, once for each version."""
        (version,) = await self._client.read([f"{name}.Baseline.Version"])
        if version.value and self._approved.get((number, estimator)) != version.value:
            self._approved[number, estimator] = version.value
            await self._draw(number, name, estimator, approved=True)
