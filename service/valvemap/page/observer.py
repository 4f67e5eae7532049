"""Reads the service over OPC UA, at a rate that depends on the open pages."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from valvemap.clock import Clock, utc_ns
from valvemap.errors import CommandRejected, SourceLost, SourceRejected, ValvemapError
from valvemap.page.alarm_list import AlarmList
from valvemap.page.close_up import TICK_S, CloseUp
from valvemap.page.figures import Figures
from valvemap.page.judgement import Reason, Severity, Standing, judge
from valvemap.page.layout import (
    NO_ESTIMATORS,
    ROOT,
    VERSION,
    Valve,
)
from valvemap.page.ports import Client, Wanted
from valvemap.page.reading import read_all
from valvemap.page.store import Store
from valvemap.page.surface import draw_surface
from valvemap.page.timeline import TimeLine
from valvemap.page.trends import Trends
from valvemap.readings import Reading

_TICKS_PER_ROUND = 10  # all valves are read once a second
_ROUNDS_PER_DISCOVERY = 5  # changes and actions are rare
_SURFACE_EVERY_S = 5.0  # s; drawing a map takes the service some 20 ms
_RETRY_S = (0.5, 1.0, 2.0)  # s; short, so that a restarted service reappears within seconds
_LISTENS_EVERY_S = 0.5  # s; publishing interval of alarms
_REFUSED_RETRY_S = 10.0  # s; after a refusal, which rarely ends soon


class Link(StrEnum):
    """State of the connection to the service."""

    CONNECTING = "connecting"
    UP = "up"
    LOST = "lost"
    REFUSED = "refused"


@dataclass(frozen=True)
class Row:
    """One valve in the overview; times are UTC ns, the rest l/min, counts and seconds."""

    reason: Reason
    since: int
    rmse: float
    noise: float
    samples: float
    silent_s: float
    predicted: float
    health: float


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
        self.rows: dict[int, Row] = {}
        self.frames: dict[int, dict[str, float]] = {}  # newest columns by name
        self.link, self.link_text, self.link_since = Link.CONNECTING, "", clock.now()
        self.generation = 0
        self._clock = clock
        self._wanted = wanted
        self._on_change = on_change
        self._close_up = CloseUp(client, self.store, clock)
        self.alarms = AlarmList()
        self.trends = Trends(past or client, clock, is_shared=past is None)
        self._listens_since = 0
        self._health: dict[int, float] = {}
        self._heard: dict[int, tuple[int, float]] = {}
        self._recommended: dict[str, str] = {}
        self._changed: dict[int, int] = {}
        self._approved: dict[tuple[int, str], str] = {}  # versions of the approved maps drawn
        self.figures = Figures(client, clock)
        self._version: object = None

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

    def silent_s(self, valve: int) -> float:
        """Age of a valve's newest sample, s, by the page's clock."""
        _, when = self._heard.get(valve, (0, self._clock.monotonic()))
        return self._clock.monotonic() - when

    async def look_at_figures(self) -> None:
        """Read the figures of `/metrics`, if connected."""
        if self.link is Link.UP:
            await self.figures.look(self.valves)

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
        tasks = {asyncio.create_task(self._look()), asyncio.create_task(self._draw_maps())}
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
            for number in wanted.live:
                if frame := self._close_up.newest(number):
                    self._hear(number, frame.t)
            if within == 0:
                await self._look_around(wanted, thoroughly=round_ % _ROUNDS_PER_DISCOVERY == 0)
            self._close_up.play()
            self._on_change()
            step = 1 if wanted.live else _TICKS_PER_ROUND - within
            tick += step
            await asyncio.sleep(max(begun + step * TICK_S - self._clock.monotonic(), 0.01))

    async def _draw_maps(self) -> None:
        while True:
            for valve, estimator in sorted(self._wanted().maps):
                await self._draw_map(valve, estimator)
                await self._draw_approved(valve, estimator)
            await asyncio.sleep(_SURFACE_EVERY_S if self._wanted().maps else TICK_S)

    async def _draw_map(self, valve: int, estimator: str, *, approved: bool = False) -> None:
        name = self.valves[valve].name
        try:
            surface = await draw_surface(self.client, name, estimator, approved=approved)
        except CommandRejected:
            return  # this estimator has no map yet
        now, kind = self._clock.now(), "Approved" if approved else "Surface"
        for part, matrix in surface.items():
            self.store.put(valve, f"{estimator}.{kind}{part}", matrix, 0, now)
        self._on_change()

    async def _draw_approved(self, valve: int, estimator: str) -> None:
        """Draw the approved map, once for each version."""
        (version,) = await self._read([f"{self.valves[valve].name}.Baseline.Version"])
        if version.value and self._approved.get((valve, estimator)) != version.value:
            self._approved[valve, estimator] = version.value
            await self._draw_map(valve, estimator, approved=True)

    async def _discover(self) -> None:
        """Browse all valves; increment the generation if they have changed."""
        (version,) = await self._read([VERSION])
        self._version = version.value
        folders = [child.id for child in await self.client.browse(ROOT) if not child.is_variable]
        frame_names = await self._read([f"{name}.FrameNames" for name in folders])
        found = []
        for name, columns in zip(folders, frame_names, strict=True):
            below = await self.client.browse(name)
            objects = [c.id.rpartition(".")[2] for c in below if not (c.is_variable or c.is_method)]
            estimators = tuple(e for e in objects if e not in NO_ESTIMATORS)
            if estimators and columns.value:
                found.append(Valve(name, estimators, tuple(columns.value)))
        if tuple(found) != self.valves or not self.generation:
            self.generation += 1
            self.valves = tuple(found)
            self.store.clear()
            self._approved.clear()
            self.rows.clear()
            self._close_up.forget_points()
        self._close_up.forget()
        self._heard.clear()
        self.figures.forget()

    async def _look_around(self, wanted: Wanted, *, thoroughly: bool) -> None:
        """Read the state of every valve, and the slow variables of the valves in view."""
        if not self.alarms.trouble:
            self.alarms.hear(self.client.conditions(), self.time_line, self._listens_since)
        if thoroughly:
            (version,) = await self._read([VERSION])
            if version.value != self._version:
                raise SourceLost(f"{self.client.url}: valves were added or removed; read again")
            await self._look_for_changes()
        frames = {n: self._close_up.newest(n) for n in range(len(self.valves))}
        unknown = [number for number, frame in frames.items() if frame is None]
        due = list(self._close_up.due(wanted, thoroughly=thoroughly))
        asked = [(n, f"{self._primary(n)}.PredictedFlow") for n in range(len(self.valves))]
        asked += [*((number, "Frame") for number in unknown), *due]
        readings = iter(await self._read([f"{self.valves[n].name}.{name}" for n, name in asked]))
        flows = [next(readings) for _ in self.valves]
        for number in unknown:
            frames[number] = read = next(readings)
            if number in wanted.live:
                self._close_up.show(number, read)
        for number, name in due:
            self._close_up.take(number, [name], [next(readings)])
        for number, frame in frames.items():
            if frame is not None:
                self._take_standing(number, self.valves[number], frame, flows[number])

    def _take_standing(self, number: int, valve: Valve, frame: Reading, flow: Reading) -> None:
        columns = dict(zip(valve.frame_names, frame.value or (), strict=False))
        self.frames[number] = columns
        primary = self._primary(number)
        of = {name: columns.get(f"{primary}.{name}", float("nan")) for name in _SHOWN}
        self._hear(number, frame.t)
        self.trends.see(valve, len(self.valves), frame.t, columns)
        adaptation = self.store.get(number, f"{primary}.Adaptation")
        now = self._clock.now()
        reason = judge(
            Standing(
                code=flow.code,
                status=int(of["Status"]) if of["Status"] == of["Status"] else 0,
                silent_s=self.silent_s(number),
                changed_s=(now - self._changed.get(number, 0)) * 1e-9,
                adaptation=int(adaptation.value or 0) if adaptation else 0,
                health=int(self._health.get(number, 0)),
            )
        )
        reason, since = self.time_line.stands(valve.name, reason, now)
        self.rows[number] = Row(
            reason=reason,
            since=since,
            rmse=of["ResidualRmse"],
            noise=of["NoiseStd"],
            samples=of["SampleCount"],
            silent_s=self.silent_s(number),
            predicted=of["PredictedFlow"],
            health=self._health.get(number, float("nan")),
        )

    def _primary(self, number: int) -> str:
        """The estimator that stands for a valve: the recommended one, once there is one."""
        valve = self.valves[number]
        recommended = self._recommended.get(valve.name, "")
        return recommended if recommended in valve.estimators else valve.primary

    async def _look_for_changes(self) -> None:
        """Read the abrupt changes and the operators' actions."""
        asked = [
            (number, valve, estimator)
            for number, valve in enumerate(self.valves)
            for estimator in valve.estimators
        ]
        ids = [
            f"{valve.name}.{estimator}.{name}"
            for _, valve, estimator in asked
            for name in ("ChangeCount", "ChangeTime", "ChangeSize")
        ]
        changes = await self._read(ids)
        for k, (number, valve, estimator) in enumerate(asked):
            count, time, size = changes[3 * k : 3 * k + 3]
            if isinstance(count.value, int) and count.value:
                t = in_ns(time.value)
                self._changed[number] = max(self._changed.get(number, 0), t)
                size_ = float(size.value or 0.0)
                self.time_line.changed(valve.name, estimator, count.value, t, size_)
            elif count.value == 0:
                self.time_line.changed(valve.name, estimator, 0, 0, 0.0)
        actions = await self._read(
            [f"{valve.name}.Diagnostics.LastAction" for valve in self.valves]
        )
        for valve, action in zip(self.valves, actions, strict=True):
            if isinstance(action.value, str):
                self.time_line.acted(valve.name, action.value, action.t)
        health = await self._read([f"{valve.name}.DeviceHealth" for valve in self.valves])
        self._health = {
            number: float(found.value)
            for number, found in enumerate(health)
            if isinstance(found.value, int)
        }
        recommended = await self._read([f"{valve.name}.Recommended" for valve in self.valves])
        self._recommended = {
            valve.name: str(found.value or "")
            for valve, found in zip(self.valves, recommended, strict=True)
        }

    async def _read(self, ids: Sequence[str]) -> list[Reading]:
        return await read_all(self.client, ids)

    def _hear(self, number: int, t: int) -> None:
        """Note the arrival of a newer sample, by the page's clock: the service's may differ."""
        if t and self._heard.get(number, (0, 0.0))[0] != t:
            self._heard[number] = (t, self._clock.monotonic())
        self._heard.setdefault(number, (t, self._clock.monotonic()))

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


def in_ns(time: object) -> int:
    """Convert a DateTime to UTC ns; return 0 for any other type."""
    return utc_ns(time) if isinstance(time, datetime) else 0


_SHOWN = ("Status", "ResidualRmse", "NoiseStd", "SampleCount", "PredictedFlow")
_SAID = {
    Link.CONNECTING: "Connecting to the service.",
    Link.UP: "Connected to the service.",
    Link.LOST: "The service does not answer.",
    Link.REFUSED: "The service refuses this page.",
}
