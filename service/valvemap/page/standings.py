"""State of all valves: read once a second, judged, and kept as rows of the overview."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from valvemap.clock import Clock, utc_ns
from valvemap.page.judgement import Reason, Standing, judge
from valvemap.page.layout import Valve
from valvemap.page.ports import Client
from valvemap.page.reading import read_all
from valvemap.page.store import Store
from valvemap.page.timeline import TimeLine
from valvemap.readings import Reading

_SHOWN = ("Status", "ResidualRmse", "NoiseStd", "SampleCount", "PredictedFlow")
_CHANGE = ("ChangeCount", "ChangeTime", "ChangeSize")


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


class Standings:
    """Judges the valves, by number.

    Parameters
    ----------
    client
        Client of the service.
    store
        Has the estimators' adaptation.
    time_line
        Receives changes of state.
    clock
        Age of the newest samples.

    Attributes
    ----------
    rows
        Newest row of each valve.
    frames
        Newest columns of each valve's frame, by name.
    """

    def __init__(self, client: Client, store: Store, time_line: TimeLine, clock: Clock) -> None:
        self._client, self._store, self._time_line, self._clock = client, store, time_line, clock
        self.rows: dict[int, Row] = {}
        self.frames: dict[int, dict[str, float]] = {}
        self._health: dict[int, float] = {}
        self._heard: dict[int, tuple[int, float]] = {}
        self._recommended: dict[str, str] = {}
        self._changed: dict[int, int] = {}

    def forget_ages(self) -> None:
        """Measure the samples' ages from scratch, after a reconnect."""
        self._heard.clear()

    def silent_s(self, valve: int) -> float:
        """Age of a valve's newest sample, s, by the page's clock."""
        _, when = self._heard.get(valve, (0, self._clock.monotonic()))
        return self._clock.monotonic() - when

    def hear(self, number: int, t: int) -> None:
        """Note the arrival of a newer sample, by the page's clock: the service's may differ."""
        if t and self._heard.get(number, (0, 0.0))[0] != t:
            self._heard[number] = (t, self._clock.monotonic())
        self._heard.setdefault(number, (t, self._clock.monotonic()))

    def primary(self, valve: Valve) -> str:
        """The estimator that stands for a valve: the recommended one, once there is one."""
        recommended = self._recommended.get(valve.name, "")
        return recommended if recommended in valve.estimators else valve.primary

    def take(self, number: int, valve: Valve, frame: Reading, flow: Reading) -> None:
        """Judge a valve by its newest frame and the StatusCode of its predicted flow."""
        columns = dict(zip(valve.frame_names, frame.value or (), strict=False))
        self.frames[number] = columns
        primary = self.primary(valve)
        of = {name: columns.get(f"{primary}.{name}", float("nan")) for name in _SHOWN}
        self.hear(number, frame.t)
        adaptation = self._store.get(number, f"{primary}.Adaptation")
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
        reason, since = self._time_line.stands(valve.name, reason, now)
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

    async def look_for_changes(self, valves: Sequence[Valve]) -> None:
        """Read what changes rarely: abrupt changes, actions, health, recommendations.

        Raises
        ------
        SourceLost, SourceRejected
        """
        await self._read_abrupt_changes(valves)
        for valve, action in zip(
            valves, await self._of_each(valves, "Diagnostics.LastAction"), strict=True
        ):
            if isinstance(action.value, str):
                self._time_line.acted(valve.name, action.value, action.t)
        self._health = {
            number: float(found.value)
            for number, found in enumerate(await self._of_each(valves, "DeviceHealth"))
            if isinstance(found.value, int)
        }
        recommended = await self._of_each(valves, "Recommended")
        self._recommended = {
            valve.name: str(found.value or "")
            for valve, found in zip(valves, recommended, strict=True)
        }

    async def _read_abrupt_changes(self, valves: Sequence[Valve]) -> None:
        asked = [
            (number, valve, estimator)
            for number, valve in enumerate(valves)
            for estimator in valve.estimators
        ]
        ids = [
            f"{valve.name}.{estimator}.{name}" for _, valve, estimator in asked for name in _CHANGE
        ]
        changes = await read_all(self._client, ids)
        for k, (number, valve, estimator) in enumerate(asked):
            count, time, size = changes[len(_CHANGE) * k : len(_CHANGE) * (k + 1)]
            if isinstance(count.value, int) and count.value:
                t = _in_ns(time.value)
                self._changed[number] = max(self._changed.get(number, 0), t)
                size_ = float(size.value or 0.0)
                self._time_line.changed(valve.name, estimator, count.value, t, size_)
            elif count.value == 0:
                self._time_line.changed(valve.name, estimator, 0, 0, 0.0)

    async def _of_each(self, valves: Sequence[Valve], name: str) -> list[Reading]:
        return await read_all(self._client, [f"{valve.name}.{name}" for valve in valves])


def _in_ns(time: object) -> int:
    return utc_ns(time) if isinstance(time, datetime) else 0
