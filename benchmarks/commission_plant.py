"""Test plants of commissioning: a valve with play, a supply with a limit, a load, a watchdog.

One loop runs the pure state machine of `valvemap.pipeline.commission` against them in simulated
time: samples every 10 ms, published every 40 ms, commands in force 15 ms after they were written.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from benchmarks import circumstances as c
from benchmarks.one_model_rows import both_ways, compensated
from valvemap.model.samples import Samples
from valvemap.pipeline.commission import start, step, written
from valvemap.pipeline.commission_learner import Learnt, learn
from valvemap.pipeline.commission_limits import Limits
from valvemap.pipeline.commission_plan import Plan
from valvemap.pipeline.commission_state import Command, CommissionState, Seen, Settings
from valvemap.pipeline.operator_signs import OperatorSigns
from valvemap.vocabulary.commission import Phase
from valvemap_rig.scenario import BUILTIN
from valvemap_rig.simulation import Commands as RigCommands
from valvemap_rig.simulation import advance, initial

SAMPLE_S: Final = 0.01
PUBLISHED_S: Final = 0.04
WRITE_S: Final = 0.015
WATCHDOG_S: Final = 0.45  # of the source's heartbeat, as the rig's
LEARN_S: Final = 1.0
SUPPLY, LEAST_LOAD, MOST_LOAD = 200.0, 5.0, 197.0  # bar
LOAD_LAG_S: Final = 0.08
WEAK_PUMP: Final = 25.0  # l/min
MISSED: Final = 10.0 * c.SIGMA  # l/min
BEAT_S: Final = 0.1  # s; between signs of the operator's page
BEAT_LATE_S: Final = 0.04  # s; by which each is late at most


@dataclass(frozen=True)
class Valve:
    """A valve: flow (U, dp), play (%), range of U (%), largest flow that the supply gives."""

    flow: Callable[..., Any]
    play: float = 0.0
    U_range: tuple[float, float] = (0.0, 100.0)
    pump: float = 1e9  # l/min


VALVES: Final = {
    "ordinary, no play": Valve(c.ordinary),
    "ordinary, play 4 %": Valve(c.ordinary, 4.0),
    "dead band 8 %, play 2 %": Valve(c.dead_band, 2.0),
    "laminar, play 1 %": Valve(c.laminar, 1.0),
    "compensator's knee": Valve(compensated, 0.0),
    "S-shape, play 4 %": Valve(c.s_shape, 4.0),
    "U of both signs, play 3 %": Valve(both_ways, 3.0, (-100.0, 100.0)),
    "two slopes, play 2 %": Valve(c.two_slopes, 2.0),
    "saturating, play 3 %": Valve(c.saturating, 3.0),
    "progressive, no play": Valve(c.progressive, 0.0),
}


@dataclass
class Plant:
    """The plant in simulated time; faults are set from outside."""

    valve: Valve
    seed: int
    own_U: float = 0.0
    spool: float = 0.0
    U: float = 0.0
    load: float = 150.0
    load_set: float = 150.0
    commanded: bool = False
    heartbeat: int = 0
    beaten: float = -np.inf
    stuck: bool = False
    stands: bool = False  # U, whatever is commanded
    free: float = 0.0  # where the spool were if it did not stick
    missed: float = np.inf  # when the flow of a stuck spool first differed by `MISSED`
    weak: bool = False
    p_extra: float = 0.0
    pending: deque[tuple[float, float | None, float | None, int | None]] = field(
        default_factory=deque
    )

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng([self.seed, 11])

    def write(self, now: float, U: float | None, load: float | None, beat: int | None) -> None:
        """Queue commands that come into force soon."""
        self.pending.append((now + WRITE_S, U, load, beat))

    def sample(self, now: float) -> tuple[float, float, float, float]:
        """Return U, p1, p2, Q as measured at ``now``."""
        while self.pending and self.pending[0][0] <= now:
            _, U, load, beat = self.pending.popleft()
            if beat is not None:
                self.heartbeat, self.beaten = beat, now
                if beat == 0:
                    self.commanded, self.U = False, self.own_U
            if U is not None and not self.stands:
                self.commanded, self.U = True, U
            if load is not None:
                self.load_set = load
        if self.heartbeat and self.commanded and now - self.beaten > WATCHDOG_S:
            self.commanded, self.U = False, self.own_U
        return self.measured(now)

    def measured(self, now: float) -> tuple[float, float, float, float]:
        """Return U, p1, p2, Q for the commands in force."""
        half = self.valve.play / 2.0
        self.free = min(max(self.free, self.U - half), self.U + half)
        if not self.stuck:
            self.spool = self.free
        self.load += (self.load_set - self.load) * SAMPLE_S / LOAD_LAG_S
        dp = max(SUPPLY - self.load, 0.0)
        Q = float(self.valve.flow(np.array([self.spool]), np.array([dp]))[0])
        if (
            self.stuck
            and abs(self.valve.flow(np.array([self.free]), np.array([dp]))[0] - Q) > MISSED
        ):
            self.missed = min(self.missed, now)
        p1 = SUPPLY + self.p_extra
        pump = WEAK_PUMP if self.weak else self.valve.pump
        if abs(Q) > pump:  # the supply's pressure falls until the flow fits
            share = (pump / abs(Q)) ** 2
            p1, Q = self.load + dp * share, float(np.sign(Q)) * pump
        noise = self.rng.normal(0.0, [0.05, 0.05, c.SIGMA])
        return self.U, p1 + noise[0], self.load + noise[1], Q + noise[2]


class RigPlant(Plant):
    """The virtual rig's own valve, which a client commands."""

    def __init__(self, seed: int) -> None:
        super().__init__(Valve(c.ordinary), seed)
        self._scenario = BUILTIN["external"].model_copy(update={"seed": seed})
        self._state = initial(self._scenario, 0)

    def measured(self, _now: float) -> tuple[float, float, float, float]:
        """Return what the rig's sensors show."""
        (name,) = self._state.valves
        commands = RigCommands(U={name: self.U}, load={name: self.load_set})
        self._state, block = advance(self._scenario, self._state, 1, commands)
        U, p1, p2, Q = (float(block.valves[name].column(x)[0]) for x in ("U", "p1", "p2", "Q"))
        return U, p1, p2, Q


def settings_for(valve: Valve, *, with_load: bool = True, **plan: float) -> Settings:
    """Settings of a run on one of the plants."""
    limits = Limits(
        U_range=valve.U_range,
        slew_percent_per_s=400.0 * (valve.U_range[1] - valve.U_range[0]) / 100.0,
        safe_U=0.0,
        load_range=(LEAST_LOAD, MOST_LOAD) if with_load else None,
        load_slew_bar_per_s=800.0,
        safe_load=150.0,
        p1_range=(0.8 * SUPPLY, 1.1 * SUPPLY),
        p_most=1.2 * SUPPLY,
    )
    return Settings(limits=limits, plan=Plan(**plan), opening=14.0, has_heartbeat=True)


@dataclass(frozen=True)
class Happening:
    """A fault from ``at`` s on, for ``lasts`` s."""

    kind: str
    at: float
    lasts: float = np.inf


@dataclass
class Log:
    """What was written and seen: (t, U) and (t, load) accepted, phases by time, samples."""

    writes: list[tuple[float, float]] = field(default_factory=list)
    loads: list[tuple[float, float]] = field(default_factory=list)
    phases: list[tuple[float, Phase, str]] = field(default_factory=list)
    U: list[tuple[float, float]] = field(default_factory=list)
    rows: list[tuple[float, ...]] = field(default_factory=list)


class Loop:
    """The state machine against a plant, from ``begin_s`` on; ``log`` may be that of a run before.

    ``learnt`` is advanced every `LEARN_S` if there is an ``estimator``. The source's responses to
    commands arrive after ``response_s``.
    """

    def __init__(
        self,
        plant: Plant,
        settings: Settings,
        happening: Happening | None = None,
        estimator: Any = None,
        before: "Loop | None" = None,
        begin_s: float = 0.0,
        response_s: float = 0.0,
    ) -> None:
        self.plant, self.settings, self.happening = plant, settings, happening
        self.estimator, self.begin_s, self.response_s = estimator, begin_s, response_s
        self.log = Log() if before is None else before.log
        state = CommissionState() if before is None else before.state
        self.state = start(state, begin_s)
        self.learnt = None if before is None else before.learnt
        self.seen, self.arrived, self.taken = Seen(), -np.inf, len(self.log.rows)
        self.waiting: list[tuple[float, ...]] = []
        self.signs, self.beats = OperatorSigns(), 0
        self.network = np.random.default_rng([plant.seed, 13])

    def run(self, until_s: float) -> "Loop":
        """Run until a second after the end, or ``until_s``."""
        every = round(PUBLISHED_S / SAMPLE_S)
        for k in range(round(self.begin_s / SAMPLE_S) + 1, round(until_s / SAMPLE_S)):
            now = k * SAMPLE_S
            kind = self._sample(now)
            if kind == "process killed":
                break
            if k % every == 0:
                self._publish(now, kind)
                self._step(now, kind)
            if self.state.phase.is_over and now > self.log.phases[-1][0] + 1.0:
                break
        return self

    def _sample(self, now: float) -> str:
        on = self.happening
        kind = on.kind if on is not None and on.at <= now < on.at + on.lasts else ""
        self.plant.stuck = kind == "stuck spool"
        self.plant.stands = kind == "U stands"
        self.plant.p_extra = 60.0 if kind == "pressure" else 0.0
        self.plant.weak = kind == "pump limit"
        values = self.plant.sample(now)
        self.log.U.append((now, values[0]))
        if kind not in {"source lost", "stale"}:
            self.waiting.append((now, *values))
        return kind

    def _publish(self, now: float, kind: str) -> None:
        if not self.waiting:
            return
        self.log.rows += self.waiting
        _, U, p1, p2, Q = self.waiting[-1]
        came = samples_of(self.waiting)
        self.arrived, self.waiting = now, []
        Q = np.nan if kind == "bad samples" else Q
        self.seen = replace(self.seen, U=U, p1=p1, p2=p2, Q=Q, came=came)
        if self.estimator is not None and len(self.log.rows) - self.taken >= LEARN_S / SAMPLE_S:
            self.catch_up()

    def catch_up(self) -> Learnt:
        """Learn all samples received."""
        samples, self.taken = samples_of(self.log.rows[self.taken :]), len(self.log.rows)
        before = self.learnt or Learnt(self.estimator.initial_state())
        new = learn(self.estimator, self.settings, before, samples, self.state.at)
        self.seen = replace(self.seen, error=new.error, expected=new.expected, route=new.route)
        self.seen = replace(self.seen, route_number=new.number)
        self.learnt = new
        return new

    def _step(self, now: float, kind: str) -> None:
        age_s, late_s = self._operator(now, kind)
        self.seen = replace(
            self.seen,
            connected=kind != "source lost",
            age_s=now - self.arrived,
            abort=kind == "abort",
            operator_age_s=age_s,
            operator_late_s=late_s,
        )
        before = self.state.phase
        self.state, command = step(self.settings, self.state, self.seen, now)
        if self.state.phase is not before:
            self.log.phases.append((now, self.state.phase, self.state.reason.name))
        refused = kind == "refused"
        if kind != "source lost" and not refused:
            self.plant.write(now, command.U, command.load, command.heartbeat)
            if command.U is not None:
                self.log.writes.append((now, command.U))
            if command.load is not None:
                self.log.loads.append((now, command.load))
        taken = Command() if refused else command
        self.state = written(self.state, taken, now + self.response_s, refused=taken != command)

    def _operator(self, now: float, kind: str) -> tuple[float, float]:
        """Age of the operator's last sign and delay of the next one, of a page or a terminal."""
        at = self.happening.at if self.happening is not None else np.inf
        if kind == "terminal gone":
            return now - at, now - at
        until = min(now, at) if kind == "operator gone" else now
        while self.begin_s + self.beats * BEAT_S <= until:
            late = self.network.uniform(0.0, BEAT_LATE_S)
            self.signs = self.signs.after(self.begin_s + self.beats * BEAT_S + late)
            self.beats += 1
        self.signs = self.signs.at(now)
        heard = [self.begin_s, *self.signs.heard[-1:]]
        return max(now - heard[-1], 0.0), self.signs.late_s(now)

    @property
    def due(self) -> float:
        """When the first sign that the operator's page did not send was due."""
        return self.begin_s + self.beats * BEAT_S


def samples_of(rows: list[tuple[float, ...]]) -> Samples:
    """Samples of rows (t, U, p1, p2, Q)."""
    t, U, p1, p2, Q = np.array(rows).T
    return Samples.of((t * 1e9).astype(np.int64), U, p1, p2, Q, np.full(len(t), 40.0))
