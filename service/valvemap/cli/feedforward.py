"""Feed-forward flow control, U = f(Q demanded, dp measured), with three maps of equal valves.

Three equal valves follow one flow against one varying load. The first uses the adaptive map. The
second uses its map of the new, cold valve, like a lookup table, and the third eq. (7) fitted at the
same time. There is no feedback controller: the flow error is the error of the map.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from rich.table import Table

from valvemap.config.estimators import AutoConfig, RlsConfig
from valvemap.config.feed_forward import FeedForwardConfig
from valvemap.config.valves import NodesConfig, ValveConfig
from valvemap.model.samples import Samples
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.operator_ports import Command
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap_rig.excitation import Scattered
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import advance, initial

NAME: Final = "feedforward"
LIVING, FIXED, FROZEN = "Valvistor", "FixedMap", "FrozenEq7"
COMMISSIONING_S: Final = 40.0
WINDOW_S: Final = 0.1
INTERVAL_S: Final = 0.02
LEAD_S, LEAD_PACE, MOST_LEAD_S = 0.05, 0.01, 1.0
SLEW_PERCENT_PER_S: Final = 400.0  # hysteresis play per cycle of the rig
REMEMBERED: Final = 64
SAME_U: Final = 0.011


@dataclass(frozen=True)
class Phase:
    """A phase of the scenario; errors are evaluated from ``start_s`` to ``end_s``."""

    name: str
    start_s: float
    end_s: float


PHASES: Final = (
    Phase("new, 40 °C", 10.0, 20.0),
    Phase("30 s after damage", 50.0, 60.0),
    Phase("30 s after oil of 60 °C", 105.0, 115.0),
)
END_S: Final = PHASES[-1].end_s


def demand(t_s: float) -> float:
    """Demanded flow, l/min, ``t_s`` after the scenario's start.

    >>> round(demand(0.0)), round(demand(2.5))
    (40, 66)
    """
    return 40.0 + 25.0 * math.sin(math.tau * t_s / 20.0) + 8.0 * math.sin(math.tau * t_s / 9.0)


def valves() -> tuple[ValveConfig, ...]:
    """The three valves; once armed, the answer to a valve's demand is written to its UCommand."""
    eq_7 = RlsConfig(forgetting="exponential", lam=1.0)
    written = FeedForwardConfig(slew_percent_per_s=SLEW_PERCENT_PER_S)
    return tuple(
        ValveConfig(
            name=name,
            nodes=NodesConfig.of_rig(name, commanded=True),
            feed_forward=written,
            estimators=(estimator,),
        )
        for name, estimator in ((LIVING, AutoConfig()), (FIXED, AutoConfig()), (FROZEN, eq_7))
    )


def commission(identification: Identification, scenario: Scenario) -> None:
    """Identify the new, cold valves from a recording; then freeze the estimators of two of them."""
    first = scenario.model_copy(
        update={"excitation": Scattered(hold_s=0.02), "faults": (), "valves": scenario.valves[:1]}
    )
    n = round(COMMISSIONING_S * first.sample_rate_hz)
    _, block = advance(first, initial(first, start_ns=0), n)
    recorded = block.valves[first.valves[0].name]
    samples = Samples.of(recorded.t, recorded.U, recorded.p1, recorded.p2, recorded.Q, recorded.T)
    for number, plan in enumerate(identification.plans):
        identification.take_samples(number, samples)
        if plan.name != LIVING:
            identification.do(Command.of("freeze", plan.name, plan.inverse))
    identification.maps.refresh()


def arm(identification: Identification) -> str:
    """Arm the feed-forward of all three, as an operator would; return a sentence for the log."""
    names = [plan.name for plan in identification.plans]
    for name in names:
        identification.do(Command.of("arm", name))
    return f"armed     {', '.join(names)}: this demo has called Inverse.Arm of each"


class Course:
    """Demands along the trajectory, and the flow errors.

    Parameters
    ----------
    identification
        Answers the demands.
    start_ns
        Start of the scenario, UTC ns.
    lead_s
        Initial mean delay from a sample to the effect of its answer, s; later it is measured as the
        age of the answer that a sample's U shows.
    """

    def __init__(
        self, identification: Identification, start_ns: int, lead_s: float = LEAD_S
    ) -> None:
        self._identification = identification
        self._start_ns = start_ns
        self._lead_s = lead_s
        names = [plan.name for plan in identification.plans]
        self._living = names.index(LIVING)
        self._open = dict.fromkeys(names, (0, 0.0, 0))  # window, sum of errors, number of samples
        self._squares = {(phase, name): (0.0, 0) for phase in PHASES for name in names}
        self._answers: deque[tuple[float, float]] = deque(maxlen=REMEMBERED)  # t_s, U
        self.t_s = 0.0

    def take(self, valve: str, samples: Samples) -> None:
        """Add the errors of the newest samples; set the next demand."""
        t_s = (samples.t - self._start_ns) / 1e9
        for t, Q in zip(t_s.tolist(), samples.Q.tolist(), strict=True):
            if math.isfinite(Q):
                self._count(valve, t, Q - demand(t))
        self.t_s = float(t_s[-1])
        flow = demand(self.t_s + self._lead_s)
        self._identification.do(Command.of("demand", valve, flow, float(samples.dp[-1])))
        if valve != LIVING:
            return
        if self._is_held():  # the age of a held U is undefined
            self._answers.clear()
            return
        self._measure_lead(t_s.tolist(), samples.U.tolist())
        answer, _ = self._identification.answers.required(self._living)
        self._answers.append((self.t_s, answer.U))

    def errors(self, phase: Phase) -> dict[str, float]:
        """Return the RMS flow error of each valve in a phase, l/min; NaN before it."""
        return {
            name: math.sqrt(squares / n) if n else math.nan
            for (its, name), (squares, n) in self._squares.items()
            if its is phase
        }

    def gain(self, phase: Phase) -> float:
        """Ratio of the fixed map's error to the adaptive map's error."""
        errors = self.errors(phase)
        return errors[FIXED] / errors[LIVING] if errors[LIVING] else math.nan

    def lines(self) -> list[str]:
        """Return lines for a log."""
        shown = (
            f"{phase.name}: " + ", ".join(f"{n} {e:.2f}" for n, e in self.errors(phase).items())
            for phase in PHASES
            if not math.isnan(self.gain(phase))
        )
        counted = "; ".join(shown) or "not yet counted"
        lead = f"answers act after {1000 * self._lead_s:.0f} ms"
        return [f"{self.t_s:.0f} s of {END_S:.0f}; {lead}; flow error, l/min: {counted}"]

    def table(self) -> Table:
        """Table of the comparison."""
        title = f"Flow error, l/min RMS (means over {WINDOW_S:g} s)"
        table = Table(title=title, title_justify="left")
        for heading in ("", "identified online", "fixed map", "eq. (7) frozen", "fixed / online"):
            table.add_column(heading, justify="right" if heading else "left")
        for phase in PHASES:
            errors = self.errors(phase)
            cells = (errors[LIVING], errors[FIXED], errors[FROZEN], self.gain(phase))
            table.add_row(phase.name, *("" if math.isnan(x) else f"{x:.2f}" for x in cells))
        return table

    def _is_held(self) -> bool:
        status = self._identification.armed.feed_forward(self._living)
        return status not in {FeedForwardStatus.DISARMED, FeedForwardStatus.WRITING}

    def _measure_lead(self, t_s: list[float], U: list[float]) -> None:
        for t, u in zip(t_s, U, strict=True):
            ages = [t - at for at, answer in self._answers if abs(answer - u) <= SAME_U]
            if ages and 0.0 < min(ages) < MOST_LEAD_S:
                self._lead_s += LEAD_PACE * (min(ages) - self._lead_s)

    def _count(self, valve: str, t_s: float, error: float) -> None:
        """Average errors over short windows to suppress the flow meter's noise."""
        window, total, n = self._open[valve]
        now = int(t_s / WINDOW_S)
        if now != window:
            for phase in PHASES:
                if n and phase.start_s <= window * WINDOW_S < phase.end_s:
                    squares, count = self._squares[phase, valve]
                    self._squares[phase, valve] = squares + (total / n) ** 2, count + 1
            total, n = 0.0, 0
        self._open[valve] = now, total + error, n + 1


def commands(identification: Identification) -> dict[str, float]:
    """Return the answers to the standing demands, by valve."""
    names = [plan.name for plan in identification.plans]
    answers = {
        name: identification.answers.required(number)[0].U for number, name in enumerate(names)
    }
    return {name: U for name, U in answers.items() if not np.isnan(U)}
