"""Values that only `/metrics` needs: read on request, at most once a second."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from valvemap.clock import Clock
from valvemap.errors import ValvemapError
from valvemap.page.layout import Valve
from valvemap.page.ports import Client
from valvemap.page.reading import read_all
from valvemap.readings import Reading
from valvemap.vocabulary.series import AXES

Key = TypeVar("Key")

EVERY_S = 1.0  # s; shortest interval between two reads
SERVICE = (
    "Start.Compiled",
    "Checkpoint.Age",
    "Checkpoint.Failures",
    "Checkpoint.Refused",
    "Checkpoint.Size",
    "Source.Notifications",
    "Source.Overflows",
    "Source.MissingMessages",
    "Source.Undecodable",
    "Source.FromHistory",
    "History.Lost",
    "History.Failures",
    "History.Size",
)
SUMMARY = {  # counters of the server's diagnostics, Part 5, 6.3.3
    "CurrentSessionCount": 2277,
    "CurrentSubscriptionCount": 2285,
    "SecurityRejectedSessionCount": 2279,
    "RejectedSessionCount": 3705,
    "SecurityRejectedRequestsCount": 2287,
    "RejectedRequestsCount": 2288,
}
_DIAGNOSTICS = "Diagnostics"
_BAD = 0x8000_0000


@dataclass
class Figures:
    """The newest figures.

    Attributes
    ----------
    valves
        By valve name and name of a variable of its Diagnostics.
    axes
        By name of an axis and of a quantity.
    service
        By name of a variable of Service.
    server
        By name of a counter of the server's diagnostics.
    """

    client: Client
    clock: Clock
    valves: dict[tuple[str, str], float] = field(default_factory=dict)
    axes: dict[tuple[str, str], float] = field(default_factory=dict)
    service: dict[str, float] = field(default_factory=dict)
    server: dict[str, float] = field(default_factory=dict)
    _names: dict[str, tuple[str, ...]] = field(default_factory=dict)
    _due: float = 0.0

    def forget(self) -> None:
        """Drop all values and cached names, after a reconnect."""
        self.valves, self.axes, self.service, self.server, self._names = {}, {}, {}, {}, {}
        self._due = 0.0

    async def look(self, valves: Sequence[Valve], axes: Sequence[str] = ()) -> None:
        """Read all figures if they are due; keep the old ones if the service does not answer."""
        now = self.clock.monotonic()
        if now < self._due:
            return
        self._due = now + EVERY_S
        try:
            of_valves = [
                (valve.name, name) for valve in valves for name in await self._names_of(valve.name)
            ]
            ids = [f"{valve}.{_DIAGNOSTICS}.{name}" for valve, name in of_valves]
            readings = await read_all(self.client, ids)
            of_axes = [(axis, name) for axis in axes for name in AXES]
            ids = [f"{axis}.{name}" for axis, name in of_axes]
            of_parts = await read_all(self.client, ids)
            of_service = await read_all(self.client, [f"Service.{name}" for name in SERVICE])
            of_server = await read_all(self.client, list(SUMMARY.values()))
        except ValvemapError:
            return  # the observer reports the reason
        self.valves = _numbers(of_valves, readings)
        self.axes = _numbers(of_axes, of_parts)
        self.service = _numbers(SERVICE, of_service)
        self.server = _numbers(list(SUMMARY), of_server)

    async def _names_of(self, valve: str) -> tuple[str, ...]:
        known = self._names.get(valve)
        if known is None:
            children = await self.client.browse(f"{valve}.{_DIAGNOSTICS}")
            known = tuple(c.id.rpartition(".")[2] for c in children if c.is_variable)
            self._names[valve] = known
        return known


def _numbers(keys: Sequence[Key], readings: Sequence[Reading]) -> dict[Key, float]:
    """Return the numbers by key, without Bad readings and NaN."""
    return {
        key: float(reading.value)
        for key, reading in zip(keys, readings, strict=True)
        if reading.code < _BAD
        and isinstance(reading.value, int | float)
        and not math.isnan(reading.value)
    }
