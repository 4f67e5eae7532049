"""What one seed draws: plant, clocks, intervals, and the time and kind of every fault."""

import random
from dataclasses import dataclass, replace
from typing import Final

from simulation.axis_installation import AXIS_EDITS
from simulation.draw_sources import (
    CALM_S,
    SIMULATED_S,
    SourceCase,
    coinciding,
    draw_source,
    pause,
    retyped,
    spread,
    step,
)
from simulation.leading import DEMANDS
from valvemap.pipeline.feedforward import Fallback, FeedForward

REAL_FILES: Final = 0.1  # share of the seeds
AXES: Final = 0.4  # share of the seeds with one source
PORTS: Final = 0.15
METERS: Final = 0.1
RELOADS: Final = 0.2
LED: Final = 0.05  # their ticks are ten times as many


@dataclass(frozen=True)
class Case:
    """One seed.

    ``ends`` are (time, kind, pause before the next start), ``disks`` are (start, stop, kind) of
    the state file's and the history's trouble, ``stalls`` of the process (time, duration).
    ``edits`` of the configuration are (kind, valve) behind each of the ends, ``rivals`` the times
    at which a second service is started on the same state file, ``calls`` of clients and
    ``commands`` of operators on estimators are (time, kind, valve). With ``reads`` the
    history is the real file, and clients read it: (time, part, valve, rows a page, backwards).
    ``axis`` is the source of an axis' two lines, of which it has the numbers of two valves, and
    ``axis_edits`` are the kinds of edits of its configuration behind each of the ends. With
    ``ports`` the three valves are a line and its two edges, with ``meter`` all valves are behind
    one flow meter. ``led`` are the settings of feed-forward, ``leads`` what clients do with it
    (time, kind, valve).
    """

    seed: int
    sources: tuple[SourceCase, ...]
    tick_s: float
    stale_after_s: float
    at_once: int
    history_rows: int
    thread_s: float
    sink_s: float
    ends: tuple[tuple[float, str, float], ...]
    disks: tuple[tuple[float, float, str], ...]
    stalls: tuple[tuple[float, float], ...]
    service_steps: tuple[tuple[float, float], ...]
    edits: tuple[tuple[tuple[str, int], ...], ...] = ()
    rivals: tuple[float, ...] = ()
    calls: tuple[tuple[float, str, int], ...] = ()
    commands: tuple[tuple[float, str, int], ...] = ()
    reads: tuple[tuple[float, str, int, int, bool], ...] = ()
    axis: SourceCase | None = None
    axis_edits: tuple[tuple[str, ...], ...] = ()
    ports: bool = False
    meter: bool = False
    led: FeedForward | None = None
    leads: tuple[tuple[float, str, int], ...] = ()

    @property
    def valves(self):
        return sum(len(source.valves) for source in self.sources)


def draw(seed):
    """Draw a case. Each kind of trouble is absent from many cases, so that it is seen alone."""
    case, rng = draw_axes(seed), random.Random(f"{seed} meter")
    is_plain = len(case.sources) == 1 and not case.ports  # else sources would meet less often
    if is_plain and rng.random() < METERS:
        case = _with_meter(rng, case)
    elif is_plain and rng.random() < LED:
        case = _with_leads(rng, case)
    case = _with_reloads(random.Random(f"{seed} reloads"), case)
    rng = random.Random(f"{seed} edits of the axis")
    return replace(
        case,
        axis_edits=tuple(
            tuple(rng.choice(AXIS_EDITS) for _ in range(rng.choice((0, 1, 1, 2))))
            for _ in case.ends
            if case.axis is not None
        ),
    )


def _with_reloads(rng, case):
    """The configuration is reloaded, too, edited like behind other ends."""
    if rng.random() >= RELOADS:
        return case
    times = spread(rng, SIMULATED_S - CALM_S, (1, 1, 2), lambda: ("reload", 0.0))
    is_edited = not (case.ports or case.meter or case.led)
    edits = [_edits(rng, case.valves) if is_edited else () for _ in times]
    given = case.edits or [()] * len(case.ends)
    both = sorted([*zip(case.ends, given, strict=True), *zip(times, edits, strict=True)])
    return replace(case, ends=tuple(end for end, _ in both), edits=tuple(own for _, own in both))


def _edits(rng, valves):
    n = rng.choice((0, 1, 1, 2))
    return tuple((rng.choice(EDITS), rng.randrange(valves)) for _ in range(n))


def draw_axes(seed):
    """The plant with all but edits of the axis' configuration."""
    case, rng = draw_types(seed), random.Random(f"{seed} axis")
    has_axis = rng.random() < AXES and len(case.sources) == 1  # else sources would meet less often
    case = replace(case, axis=_axis(rng) if has_axis else None)
    return _with_ports(rng, case) if rng.random() < PORTS else case


def _with_ports(rng, case):
    """One valve with ports in the place of the others; its configuration is not edited."""
    quiet_from = SIMULATED_S - CALM_S
    source = coinciding(rng, draw_source(rng, (0, 1, 2), quiet_from), quiet_from)
    return replace(case, sources=(source,), edits=(), calls=(), commands=(), reads=(), ports=True)


def _with_meter(rng, case):
    """Two or three valves behind one meter in the place of the others; not edited, not operated."""
    quiet_from = SIMULATED_S - CALM_S
    valves = tuple(range(rng.choice((2, 3))))
    source = retyped(rng, coinciding(rng, draw_source(rng, valves, quiet_from), quiet_from))
    return replace(case, sources=(source,), edits=(), calls=(), commands=(), reads=(), meter=True)


def _with_leads(rng, case):
    """Valves that are led: their units are not edited, and the service steps every 0.1 s."""
    valve = lambda: rng.randrange(case.valves)  # noqa: E731
    settings = FeedForward(
        (5.0, 95.0),
        rng.choice((5.0, 50.0)),
        rng.choice(tuple(Fallback)),
        fallback_U=20.0,
        max_age_s=rng.choice((1.5, 4.0, 8.0)),
        max_width_percent=100.0,
        has_heartbeat=True,
    )
    armed = [(4.0 + v, kind, v) for v in range(case.valves) for kind in ("arm", DEMANDS[1])]
    kinds = ("arm", "arm", "disarm", "withdraw", *DEMANDS)
    more = spread(rng, SIMULATED_S, (4, 10), lambda: (rng.choice(kinds), valve()))
    refused = lambda: spread(rng, SIMULATED_S, (0, 0, 1), lambda: (rng.uniform(0.1, 9.0),))  # noqa: E731
    sources = tuple(
        replace(one, refusals=tuple((at, at + by) for at, by in refused())) for one in case.sources
    )
    return replace(case, sources=sources, tick_s=0.1, edits=(), led=settings, leads=(*armed, *more))


def _axis(rng):
    """A source of one axis: faster than those of valves, with the same faults."""
    quiet_from = SIMULATED_S - CALM_S
    source = replace(draw_source(rng, (0, 1), quiet_from), period_s=0.7)
    return coinciding(rng, source, quiet_from)


def draw_types(seed):
    """The plant with its faults, people, commands, and nodes that change, but for axes."""
    case, rng = draw_operators(seed), random.Random(f"{seed} types")
    return replace(case, sources=tuple(retyped(rng, source) for source in case.sources))


def draw_operators(seed):
    """The plant with its faults, people, commands, and nodes that are deleted and created again."""
    case, rng = draw_people(seed), random.Random(f"{seed} operators")
    quiet_from = SIMULATED_S - CALM_S
    return replace(
        case,
        sources=tuple(coinciding(rng, source, quiet_from) for source in case.sources),
        commands=spread(
            rng, SIMULATED_S, (0, 0, 3), lambda: (rng.choice(COMMANDS), rng.randrange(case.valves))
        ),
        reads=_reads(rng, case),
    )


def _reads(rng, case):
    """One seed of ten has the real file: it takes as long as all else."""
    counts = (3, 6) if rng.random() < REAL_FILES else (0,)
    return spread(
        rng,
        SIMULATED_S,
        counts,
        lambda: (
            rng.choice(("Signals", "Inverse", "estimator")),
            rng.randrange(case.valves),
            rng.choice((1, 3, 20, 1000)),
            rng.random() < 0.5,
        ),
    )


def draw_people(seed):
    """The plant with its faults and people, but for commands and nodes that change."""
    case, rng = draw_plain(seed), random.Random(f"{seed} people")
    valve = lambda: rng.randrange(case.valves)  # noqa: E731
    quiet_from = SIMULATED_S - CALM_S
    return replace(
        case,
        sink_s=case.sink_s and rng.choice((case.sink_s, 2.5)),
        edits=tuple(
            tuple((rng.choice(EDITS), valve()) for _ in range(rng.choice((0, 1, 1, 2))))
            for _ in case.ends
        ),
        rivals=tuple(at for (at,) in spread(rng, quiet_from, (0, 0, 1), tuple)),
        calls=spread(rng, SIMULATED_S, (0, 4), lambda: (rng.choice(CALLS), valve())),
    )


def draw_plain(seed):
    """The plant and its faults, without edits of the configuration, rivals and clients."""
    rng = random.Random(seed)
    valves = rng.choice((1, 1, 2, 2, 3))
    parts = rng.choice((1, valves)) if valves > 1 else 1
    owned = [tuple(range(k, valves, parts)) for k in range(parts)]
    quiet_from = SIMULATED_S - CALM_S
    return Case(
        seed=seed,
        sources=tuple(draw_source(rng, own, quiet_from) for own in owned),
        tick_s=rng.choice((0.5, 1.0, 2.0)),
        stale_after_s=rng.choice((6.0, 9.0)),
        at_once=rng.choice((6, 24, 600)),
        history_rows=rng.choice((40, 100_000, 100_000)),
        thread_s=rng.choice((0.0, 0.2, 1.5)),
        sink_s=rng.choice((0.0, 0.0, 0.6)),
        ends=spread(rng, quiet_from, (0, 1, 1, 2), lambda: (rng.choice(_ENDS), pause(rng))),
        disks=tuple(
            (at, at + rng.uniform(0.5, 12.0), rng.choice(("state", "history")))
            for (at,) in spread(rng, quiet_from - 12.0, (0, 0, 1, 2), tuple)
        ),
        stalls=spread(rng, quiet_from, (0, 0, 1), lambda: (rng.uniform(0.2, 8.0),)),
        service_steps=spread(rng, quiet_from, (0, 0, 0, 1), lambda: (step(rng),)),
    )


EDITS: Final = (
    *("flow", "pressure", "command", "node", "name", "swap"),
    *("estimator", "also", "accuracy"),
)
CALLS: Final = ("demand", "predict", "invert", "freeze and resume", "unknown", "not finite")
COMMANDS: Final = ("reset", "forget more", "forget nothing", "freeze", "resume")
_ENDS: Final = ("kill", "kill", "power", "stop")
