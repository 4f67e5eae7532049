"""Valves in view: their fast variables are subscribed, the slow ones are polled."""

import math
from collections.abc import Iterator, Mapping, Sequence

from valvemap.clock import Clock
from valvemap.errors import SourceRejected
from valvemap.page.layout import Valve, Variables, sort_variables
from valvemap.page.play_out import PlayOut
from valvemap.page.points import Points
from valvemap.page.ports import Client, Wanted
from valvemap.page.reading import read_all
from valvemap.page.store import Store, store_readings
from valvemap.readings import Reading
from valvemap.vocabulary.edges import split_id

TICK_S = 0.1  # s; poll interval of a valve that is in view
_FOLLOWED_EVERY_S = 0.5  # s; publishing interval: a message costs more than five results in it
_BAD_NO_DATA = 0x80B1_0000
_BAD = 0x8000_0000
_FRAME = "Frame"


class CloseUp:
    """Keeps the newest values of the valves in view, by valve number.

    Parameters
    ----------
    client
        Client of the service.
    store
        Receives the values.
    clock
        Decides which values are due.
    """

    def __init__(self, client: Client, store: Store, clock: Clock) -> None:
        self._client, self._store, self._clock = client, store, clock
        self._variables: dict[int, Variables] = {}
        self._points: dict[int, Points] = {}
        self.forget()

    def forget(self) -> None:
        """Reset after a reconnect."""
        self._valves: dict[int, Valve] = {}
        self._is_following = False
        self._newest: dict[int, Reading] = {}
        self._frames: dict[int, PlayOut[Reading]] = {}
        self._drawn: set[tuple[int, str]] = set()
        self._variables.clear()

    def forget_points(self) -> None:
        """Drop the measured points, after the set of valves has changed."""
        self._points.clear()

    async def watch(self, valves: Mapping[int, Valve]) -> None:
        """Subscribe to exactly these valves; read the ones that were not in view before.

        Raises
        ------
        SourceLost, SourceRejected
        """
        if valves.keys() == self._valves.keys():
            return
        new = [number for number in valves if number not in self._valves]
        self._valves = dict(valves)
        for kept in (self._newest, self._frames):
            for number in kept.keys() - valves.keys():
                del kept[number]
        self._drawn = {(number, name) for number, name in self._drawn if number in valves}
        for number in new:
            await self._find_variables(number)
        await self._follow()
        for number in new:
            variables = self._variables[number]
            names = [_FRAME, *variables.live, *variables.state, *variables.slow, *variables.fixed]
            frame, *others = await read_all(self._client, self._ids(number, names))
            self._newest[number] = frame
            self.show(number, self._valves[number], frame)
            store_readings(self._store, number, names[1:], others)

    def newest(self, number: int) -> Reading | None:
        """Return the newest frame of a valve, None if it is not subscribed."""
        return self._newest.get(number) if self._is_following else None

    def hear(self) -> None:
        """Process the notifications received since the last call.

        Raises
        ------
        SourceLost, SourceRejected
        """
        if not self._is_following:
            return
        of = {valve.name: number for number, valve in self._valves.items()}
        frames: dict[int, list[Reading]] = {}
        for id_, reading in self._client.changes():
            valve, name = split_id(id_)
            number = of.get(valve)
            if number is None:
                continue
            if name == _FRAME:
                frames.setdefault(number, []).append(reading)
            else:
                store_readings(self._store, number, [name], [reading])
        for number, some in frames.items():
            self._newest[number] = some[-1]
            results = self._frames.setdefault(number, PlayOut(_FOLLOWED_EVERY_S, TICK_S))
            results.come(some, self._clock.monotonic())

    def play(self) -> None:
        """Show the frames that are due."""
        now = self._clock.monotonic()
        for number, results in self._frames.items():
            for frame in results.due(now):
                self.show(number, self._valves[number], frame)

    def due(self, wanted: Wanted, *, thoroughly: bool) -> Iterator[tuple[int, str]]:
        """Yield (valve number, variable name) of each variable to read in this round."""
        for number in self._valves:
            variables = self._variables[number]
            names = list(variables.state)
            maps = {estimator for of, estimator in wanted.maps if of == number}
            if not self._is_following:
                names += variables.live
            if thoroughly or maps:
                names += variables.slow
            for name in variables.maps:
                estimator = name.partition(".")[0]
                if estimator in maps and (thoroughly or (number, estimator) not in self._drawn):
                    names.append(name)
            self._drawn |= {(number, estimator) for estimator in maps}
            if maps:
                self._store.put(number, "Points", self._of(number).rows, 0, self._clock.now())
            for name in names:
                yield number, name

    def show(self, number: int, valve: Valve, frame: Reading) -> None:
        """Store the columns of a valve's frame."""
        for name, value in zip(valve.frame_names, frame.value or (), strict=False):
            lost = name.startswith("Signals.") and math.isnan(value)
            self._store.put(number, name, value, _BAD_NO_DATA if lost else frame.code, frame.t)
        self._take_point(number)

    async def _follow(self) -> None:
        ids = [
            id_
            for number in self._valves
            for id_ in self._ids(number, (_FRAME, *self._variables[number].live))
        ]
        try:
            await self._client.follow(ids, _FOLLOWED_EVERY_S)
            self._is_following = bool(ids)
        except SourceRejected:  # no room for the subscription: poll each second
            self._is_following = False
            self._frames.clear()

    async def _find_variables(self, number: int) -> None:
        if number in self._variables:
            return
        valve = self._valves[number]
        names = []
        for child in await self._client.browse(valve.name):
            if child.is_variable:
                names.append(child.id)
            elif not child.is_method:
                names += [c.id for c in await self._client.browse(child.id) if c.is_variable]
        own = [name.removeprefix(f"{valve.name}.") for name in names]
        self._variables[number] = sort_variables(valve, own)

    def _ids(self, number: int, names: Sequence[str]) -> list[str]:
        return [f"{self._valves[number].name}.{name}" for name in names]

    def _of(self, number: int) -> Points:
        return self._points.setdefault(number, Points())

    def _take_point(self, number: int) -> None:
        """Add the valve's operating point."""
        U, dp, Q = (self._store.get(number, f"Signals.{name}") for name in ("U", "dp", "Q"))
        if U is None or dp is None or Q is None or max(U.code, dp.code, Q.code) >= _BAD:
            return
        values = (U.value, dp.value, Q.value)
        if all(isinstance(value, float) for value in values):
            self._of(number).add(*values)
