"""Reads the service over OPC UA, at a rate that depends on the open pages."""

import asyncio
from collections.abc import Callable, Sequence
from enum import StrEnum

from valvemap.clock import Clock
from valvemap.errors import CommandRejected, SourceLost, SourceRejected, ValvemapError
from valvemap.page.alarm_list import AlarmList
from valvemap.page.close_up import TICK_S, CloseUp
from valvemap.page.drawn_maps import DrawnMaps
from valvemap.page.figures import Figures
from valvemap.page.judgement import Severity
from valvemap.page.layout import (
    ROOT,
    START,
    VERSION,
    Part,
    PartKind,
    Valve,
    axis_of,
    estimators_of,
    part_of,
)
from valvemap.page.machine_parts import MachineParts
from valvemap.page.ports import Client, Wanted
from valvemap.page.reading import read_all
from valvemap.page.standings import Standings
from valvemap.page.store import Store, store_readings
from valvemap.page.timeline import TimeLine
from valvemap.page.trends import Trends
from valvemap.readings import Reading

_TICKS_PER_ROUND = 10  # all valves are read once a second
_ROUNDS_PER_DISCOVERY = 5  # changes and actions are rare
_RETRY_S = (0.5, 1.0, 2.0)  # s; short, so that a restarted service reappears within seconds
_LISTENS_EVERY_S = 0.5  # s; publishing interval of alarms
_REFUSED_RETRY_S = 10.0  # s; after a refusal, which rarely ends soon


class Link(StrEnum):
    """State of the connection to the service."""

    CONNECTING = "connecting"
    UP = "up"
    LOST = "lost"
    REFUSED = "refused"


class Observer:
    """Keeps the newest values of the service.

    Parameters
    ----------
    client
        Client of the service.
    clock
        Timestamps and intervals.
    wanted
        Returns the valves and maps in view.
    on_change
        Called after each read.
    past
        A second client, for the history; None: the first one reads it, too.
    """

    def __init__(
        self,
        client: Client,
        clock: Clock,
        wanted: Callable[[], Wanted],
        on_change: Callable[[], None],
        past: Client | None = None,
    ) -> None:
        self.client = client
        self.store = Store()
        self.time_line = TimeLine()
        self.valves: tuple[Valve, ...] = ()
        self.parts: tuple[Part, ...] = ()
        self.standings = Standings(client, self.store, self.time_line, clock)
        self.link, self.link_text, self.link_since = Link.CONNECTING, "", clock.now()
        self.generation = 0
        self._clock = clock
        self._wanted = wanted
        self._on_change = on_change
        self._close_up = CloseUp(client, self.store, clock)
        self.alarms = AlarmList()
        self.trends = Trends(past or client, clock, is_shared=past is None)
        self._maps = DrawnMaps(client, self.store, clock, on_change)
        self._parts = MachineParts(client, self.store)
        self._listens_since = 0
        self.figures = Figures(client, clock)
        self._version: object = None
        self.start = ""  # why a service that answers does not identify yet; empty: it does

    async def run(self) -> None:
        """Read until cancelled; reconnect after every failure."""
        failures = 0
        while True:
            try:
                await self.client.connect()
                await self._discover()
                await self._listen()
                failures = 0
                self._say(Link.UP, "")
                await self._look_for_ever()
            except SourceLost as error:
                self._say(Link.LOST, str(error))
                pause = _RETRY_S[min(failures, len(_RETRY_S) - 1)]
            except ValvemapError as error:
                self._say(Link.REFUSED, str(error))
                pause = _REFUSED_RETRY_S
            finally:
                await self.client.close()
                await self.trends.close()
            failures += 1
            await asyncio.sleep(pause)

    @property
    def places(self) -> tuple[Valve | Part, ...]:
        """All valves and parts; their numbers count through."""
        return (*self.valves, *self.parts)

    async def look_at_figures(self) -> None:
        """Read the figures of `/metrics`, if connected."""
        if self.link is Link.UP:
            axes = [part.name for part in self.parts if part.kind is PartKind.AXIS]
            await self.figures.look(self.valves, axes)

    async def _listen(self) -> None:
        """Subscribe to alarms; without them the page shows everything else."""
        self.trends.forget()
        try:
            await self.client.listen(_LISTENS_EVERY_S)
        except (SourceRejected, CommandRejected) as error:
            self.alarms.forget(str(error))
        else:
            self.alarms.forget("")
            self._listens_since = self._clock.now()

    async def _look_for_ever(self) -> None:
        drawing = self._maps.draw_for_ever(self._wanted, lambda: self.valves)
        tasks = {asyncio.create_task(self._look()), asyncio.create_task(drawing)}
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_EXCEPTION)
            for task in done:
                task.result()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _look(self) -> None:
        tick = 0
        while True:
            begun = self._clock.monotonic()
            wanted = self._wanted()
            round_, within = divmod(tick, _TICKS_PER_ROUND)
            await self._close_up.watch({number: self.valves[number] for number in wanted.live})
            self._close_up.hear()
            await self._watch_parts(wanted)
            for number in wanted.live:
                if frame := self._close_up.newest(number):
                    self.standings.hear(number, frame.t)
            if within == 0:
                await self._look_around(wanted, thoroughly=round_ % _ROUNDS_PER_DISCOVERY == 0)
            self._close_up.play()
            self._on_change()
            step = 1 if wanted.live or wanted.parts else _TICKS_PER_ROUND - within
            tick += step
            await asyncio.sleep(max(begun + step * TICK_S - self._clock.monotonic(), 0.01))

    async def _watch_parts(self, wanted: Wanted) -> None:
        parts = {number: part_of(self.places[number]) for number in wanted.parts}
        await self._parts.watch({number: part for number, part in parts.items() if part})

    async def _discover(self) -> None:
        """Browse all valves; increment the generation if they have changed."""
        (version,) = await self._read([VERSION])
        self._version = version.value
        folders = [child.id for child in await self.client.browse(ROOT) if not child.is_variable]
        frame_names = await self._read([f"{name}.FrameNames" for name in folders])
        found, parts = list[Valve](), list[Part]()
        for name, columns in zip(folders, frame_names, strict=True):
            below = await self.client.browse(name)
            objects = [c.id.rpartition(".")[2] for c in below if not (c.is_variable or c.is_method)]
            frame = tuple(columns.value or ())
            if estimators := estimators_of(objects, frame):
                found.append(Valve(name, estimators, frame))
            elif axis := axis_of(name, objects):
                parts.append(axis)
        if (*found, *parts) != self.places or not self.generation:
            self.generation += 1
            self.valves, self.parts = tuple(found), tuple(parts)
            self.store.clear()
            self._maps.forget()
            self.standings.rows.clear()
            self._close_up.forget_points()
        self._close_up.forget()
        self._parts.forget()
        self.standings.forget_ages()
        self.figures.forget()

    async def _look_around(self, wanted: Wanted, *, thoroughly: bool) -> None:
        """Read the state of every valve, and the slow variables of the valves in view."""
        if not self.alarms.trouble:
            self.alarms.hear(self.client.conditions(), self.time_line, self._listens_since)
        if thoroughly:
            version, compiled, text = await self._read([VERSION, *_START])
            is_complete = not isinstance(compiled.value, float) or compiled.value >= _ALL
            self.start = "" if is_complete else str(text.value)
            if version.value != self._version:
                raise SourceLost(f"{self.client.url}: valves were added or removed; read again")
            await self.standings.look_for_changes(self.valves)
        frames = {n: self._close_up.newest(n) for n in range(len(self.valves))}
        unknown = [number for number, frame in frames.items() if frame is None]
        due = [*self._close_up.due(wanted, thoroughly=thoroughly), *self._parts.due(wanted.parts)]
        primaries = [self.standings.primary(valve) for valve in self.valves]
        asked = [(n, f"{primary}.PredictedFlow") for n, primary in enumerate(primaries)]
        asked += [*((number, "Frame") for number in unknown), *due]
        places = self.places
        readings = iter(await self._read([f"{places[n].name}.{name}" for n, name in asked]))
        flows = [next(readings) for _ in self.valves]
        for number in unknown:
            frames[number] = read = next(readings)
            if number in wanted.live | wanted.from_afar:
                self._close_up.show(number, self.valves[number], read)
        for number, name in due:
            store_readings(self.store, number, [name], [next(readings)])
        for number, frame in frames.items():
            if frame is not None:
                valve = self.valves[number]
                self.standings.take(number, valve, frame, flows[number])
                self.trends.see(valve, len(self.valves), frame.t, self.standings.frames[number])

    async def _read(self, ids: Sequence[str]) -> list[Reading]:
        return await read_all(self.client, ids)

    def _say(self, link: Link, text: str) -> None:
        if (link, text) == (self.link, self.link_text):
            return
        now = self._clock.now()
        if link != self.link:
            self.link_since = now
            severity = Severity.GOOD if link is Link.UP else Severity.ALARM
            self.time_line.add(now, "", "link", severity, _SAID[link])
        self.link, self.link_text = link, text
        self._on_change()


_ALL = 100.0  # % of the kernels
_START = f"{START}.Compiled", f"{START}.Text"
_SAID = {
    Link.CONNECTING: "Connecting to the service.",
    Link.UP: "Connected to the service.",
    Link.LOST: "The service does not answer.",
    Link.REFUSED: "The service refuses this page.",
}
