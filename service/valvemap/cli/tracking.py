"""Four equal axes follow the same moves: PI alone, with a table, a fixed map, and the living map.

The rig has the position controllers. The service answers for the last two of them: the set speed,
as much ahead as its answer takes to act, is the demand, and the answer is added to the controller's
command. One axis keeps the map of the new valve, the other one continues to learn.
"""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from rich.table import Table

from valvemap.app.axes import axes_file, plan_of
from valvemap.cli.feedforward import Phase
from valvemap.clock import Clock
from valvemap.config.axes import AxisConfig, AxisNodesConfig
from valvemap.config.feed_forward import AxisFeedForwardConfig
from valvemap.config.models import Config
from valvemap.config.valves import RIG_NAMESPACE
from valvemap.model.axis import AxisSamples
from valvemap.model.samples import Floats, Times
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_ports import AxisOperator
from valvemap.pipeline.axis_states import checkpoints_of
from valvemap.storage.checkpoints import CheckpointFile
from valvemap_rig.machine import Machine
from valvemap_rig.machine_programme import moves
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import advance, initial

NAME: Final = "axis"
SCENARIO: Final = "tracking"
PI, TABLE, FIXED, LIVING = "PIAlone", "Table", "FixedMap", "LivingMap"
TITLES: Final = {PI: "PI alone", TABLE: "table", FIXED: "fixed map", LIVING: "living map"}
COMMISSIONING_S: Final = 320.0  # about 240 s of movement: play and spool are settled
INTERVAL_S: Final = 0.02
EFFECT_S: Final = 0.03  # from an answer to its effect: the write, the rig's next block, the spool
SLEW_PERCENT_PER_S: Final = 2_000.0  # a move begins within a tenth of a second
PHASES: Final = (Phase("new", 10.0, 60.0), Phase("60 s after two edges -30 %", 120.0, 175.0))
END_S: Final = PHASES[-1].end_s
_SIGNALS: Final = {
    "U": "U",
    "position": "x",
    "set_position": "xSet",
    "T": "T",
    "sequence": "Sequence",
}
_PRESSURES: Final = {name: name for name in ("pA", "pB", "pS", "pT")}
_WRITTEN: Final = {"required_U": "UCommand", "heartbeat": "Heartbeat"}


def axes(scenario: Scenario) -> tuple[AxisConfig, ...]:
    """The four axes; the answers for two of them are written to their UCommand, once armed."""
    return tuple(_axis(machine) for machine in scenario.machines)


def _axis(machine: Machine) -> AxisConfig:
    cylinder, is_led = machine.cylinder, machine.takes_commands
    of_rig = _SIGNALS | _PRESSURES | (_WRITTEN if is_led else {})
    head = f"nsu={RIG_NAMESPACE};s={machine.name}."
    written = AxisFeedForwardConfig(slew_percent_per_s=SLEW_PERCENT_PER_S)
    return AxisConfig(
        name=machine.name,
        nodes=AxisNodesConfig(**{node: head + signal for node, signal in of_rig.items()}),
        piston_mm=cylinder.piston_mm,
        rod_mm=cylinder.rod_mm,
        stroke_mm=cylinder.stroke_mm,
        dead_A_l=cylinder.dead_A_l,
        dead_B_l=cylinder.dead_B_l,
        frozen=machine.name == FIXED,
        **({"feed_forward": written} if is_led else {}),
    )


def commission(config: Config, scenario: Scenario, seconds: float = COMMISSIONING_S) -> None:
    """Identify the new valve from work with the table, and store the map for both led axes."""
    led = [Axis(plan_of(config, axis)) for axis in config.axes if axis.name in (FIXED, LIVING)]
    first = commissioned(scenario, Axis(plan_of(config, config.axes[-1])), seconds)
    learnt = first.learner.learnt
    assert learnt is not None, "five minutes of the rig's work identify an axis"  # noqa: S101
    with CheckpointFile(axes_file(config)) as store:
        for axis in led:
            axis.learner.continue_from(learnt)
            store.save(checkpoints_of(axis, first.t, axis.to_bytes()))


def commissioned(scenario: Scenario, axis: Axis, seconds: float) -> Axis:
    """Return the axis after so long work of the new machine with the table."""
    machine = next(one for one in scenario.machines if one.name == TABLE)
    work = scenario.model_copy(update={"machines": (machine,), "faults": ()})
    state, n = initial(work, 0), round(work.sample_rate_hz)
    for _ in range(round(seconds)):
        state, block = advance(work, state, n)
        found = block.machines[TABLE]
        names = [name for name in machine.signals if not name.endswith("Set")]
        axis.take(AxisSamples.of(found.t, **{name: found.shown[name] for name in names}))
        while (job := axis.learner.job()) is not None:
            axis.learner.accept(job())
    return axis


class Course:
    """Demands along the moves, and the tracking errors.

    Parameters
    ----------
    scenario
        The four machines.
    clock
        Tells how old samples are.
    """

    def __init__(self, scenario: Scenario, clock: Clock) -> None:
        self._scenario, self._clock = scenario, clock
        self._machine = scenario.machines[0]
        self._start_ns: int | None = None
        self._armed: set[str] = set()
        self._squares = {(phase, name): (0.0, 0) for phase in PHASES for name in TITLES}
        self.t_s, self.lead_s = 0.0, 0.0

    def begin(self, start_ns: int) -> None:
        """Note the time of the scenario's first sample, UTC ns."""
        self._start_ns = start_ns

    def take(self, operator: AxisOperator, axis: str, samples: AxisSamples) -> None:
        """Add the errors of the newest samples; set the next demand."""
        if self._start_ns is None:
            return
        t_s = 1e-9 * (samples.t - self._start_ns)
        self.t_s = float(t_s[-1])
        x_set, _ = self._set(np.rint(t_s * self._scenario.sample_rate_hz).astype(np.int64))
        for phase in PHASES:
            inside = (t_s >= phase.start_s) & (t_s < phase.end_s) & np.isfinite(samples.x)
            errors = (samples.x - x_set)[inside]
            squares, n = self._squares[phase, axis]
            self._squares[phase, axis] = squares + float(errors @ errors), n + len(errors)
        if axis not in (FIXED, LIVING):
            return
        if axis not in self._armed:
            self._armed.add(axis)
            operator.arm_axis(axis, armed=True)
        self.lead_s = 1e-9 * (self._clock.now() - int(samples.t[-1])) + EFFECT_S
        operator.demand_speed(axis, self._speed(self.t_s + self.lead_s))

    def _set(self, index: Times) -> tuple[Floats, Floats]:
        """Set position (mm) and set speed (mm/s) at these samples."""
        stroke, name = self._machine.cylinder.stroke_mm, self._machine.repeats or ""
        rate, seed = self._scenario.sample_rate_hz, self._scenario.seed
        return moves(self._machine.programme, stroke, index, rate, seed, name)

    def _speed(self, t_s: float) -> float:
        at = t_s * self._scenario.sample_rate_hz
        low = math.floor(at)
        _, speed = self._set(np.array([low, low + 1]))
        return float(speed[0] + (at - low) * (speed[1] - speed[0]))

    def errors(self, phase: Phase) -> Mapping[str, float]:
        """Return the RMS tracking error of each axis in a phase, mm; NaN before it."""
        return {
            name: math.sqrt(squares / n) if n else math.nan
            for (its, name), (squares, n) in self._squares.items()
            if its is phase
        }

    def lines(self) -> list[str]:
        """Return lines for a log."""
        shown = (
            f"{phase.name}: "
            + ", ".join(f"{TITLES[name]} {error:.2f}" for name, error in self.errors(phase).items())
            for phase in PHASES
            if not math.isnan(self.errors(phase)[LIVING])
        )
        counted = "; ".join(shown) or "not yet counted"
        lead = f"answers act after {1000 * self.lead_s:.0f} ms"
        return [f"{self.t_s:.0f} s of {END_S:.0f}; {lead}; tracking error, mm: {counted}"]

    def table(self) -> Table:
        """Table of the comparison."""
        table = Table(title="Tracking error, mm RMS", title_justify="left")
        for heading in ("", *TITLES.values(), "living / fixed"):
            table.add_column(heading, justify="right" if heading else "left")
        for phase in PHASES:
            errors = self.errors(phase)
            cells = (*(errors[name] for name in TITLES), errors[LIVING] / errors[FIXED])
            table.add_row(phase.name, *("" if math.isnan(x) else f"{x:.2f}" for x in cells))
        return table
