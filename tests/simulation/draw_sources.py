"""What one seed draws of a source and its server: rates, queues, clocks, and their faults."""

from dataclasses import dataclass, replace
from typing import Final

from valvemap.vocabulary.signals import Signal

SIMULATED_S: Final = 60.0
CALM_S: Final = 15.0  # at the end: no faults, so that all that waits arrives
TYPES: Final = ("Float", "Int16", "String")
_RETYPED: Final = (Signal.U, Signal.P1, Signal.P2, Signal.Q, Signal.T)
_DELETED: Final = (Signal.U, Signal.P1, Signal.P2, Signal.Q, Signal.SEQUENCE)


@dataclass(frozen=True)
class SourceCase:
    """One source and its server; times in s, sizes in samples or messages.

    ``history`` is how many samples of each valve the server remembers; ``cuts`` are (start,
    duration, noticed after), ``steps`` of its clock (time, by how much), ``restarts`` (time, time
    without a server, by how much its clock is set): sessions, queues, messages and history are
    gone, and the running number begins at 0. ``skipped`` are the times whose next sample the
    source numbers and does not take, ``gone`` (start, stop, valve, signal) the nodes that were
    deleted and created again, ``retyped`` (start, stop, valve, signal, type) those of another type
    for a while, ``refusals`` (start, stop) when it takes no commands.
    """

    valves: tuple[int, ...]
    period_s: float
    publishing_s: float
    numbered: bool
    first_number: int
    queue: int
    messages: int
    lifetime_s: float
    history: int
    late: float
    duplicated: float
    split: float
    bad: float
    cuts: tuple[tuple[float, float, float], ...]
    steps: tuple[tuple[float, float], ...]
    restarts: tuple[tuple[float, float, float], ...]
    skipped: tuple[float, ...] = ()
    gone: tuple[tuple[float, float, int, int], ...] = ()
    retyped: tuple[tuple[float, float, int, int, str], ...] = ()
    refusals: tuple[tuple[float, float], ...] = ()


def draw_source(rng, valves, quiet_from):
    numbered = rng.random() < 0.75
    messy = numbered and rng.random() < 0.5
    split = rng.choice((0.0, 0.1)) if messy else 0.0
    return SourceCase(
        valves=valves,
        period_s=rng.choice((0.7, 1.3, 2.1)),
        publishing_s=rng.choice((2.0, 3.0)),
        numbered=numbered,
        first_number=0 if messy else rng.choice((0, 7, 2**32 - 20)),
        queue=rng.choice((4, 60, 60)),
        messages=rng.choice((2, 20, 20)),
        lifetime_s=rng.choice((6.0, 120.0, 120.0)),
        history=rng.choice((0, 0, 15, 1000)),
        late=rng.choice((0.0, 0.1)) if messy else 0.0,
        duplicated=rng.choice((0.0, 0.1)),
        split=split,
        bad=rng.choice((0.0, 0.05)),
        cuts=spread(
            rng,
            quiet_from - 5.0,
            (0, 1, 2),
            lambda: (rng.uniform(0.1, 20.0), rng.choice((0.0, 4.5))),
        ),
        steps=spread(rng, quiet_from, (0, 0, 1), lambda: (step(rng),)),
        restarts=spread(
            rng, quiet_from - 5.0, (0, 0, 0, 1), lambda: (rng.uniform(0.5, 9.0), _step_or_none(rng))
        ),
    )


def coinciding(rng, source, quiet_from):
    """Draw skipped samples and deleted nodes; steps of a clock often coincide with other events."""
    gone = spread(
        rng,
        quiet_from - 5.0,
        (0, 0, 0, 1),
        lambda: (rng.uniform(0.5, 12.0), rng.choice(source.valves), rng.choice(_DELETED)),
    )
    skipped = tuple(at for (at,) in spread(rng, quiet_from, (0, 0, 2), tuple))
    moments = [at for at, *_ in (*source.cuts, *source.restarts, *gone)]
    moments += [at + duration for at, duration, *_ in source.cuts] + list(skipped)
    steps = source.steps
    if moments and rng.random() < 0.5:  # 2 s apart at most: the samples around the event
        steps = tuple((rng.choice(moments) + rng.uniform(-2.0, 2.0), by) for _, by in steps)
    if steps and rng.random() < 0.5:
        skipped = (*skipped, rng.choice(steps)[0] + rng.uniform(-2.0, 1.0) * source.period_s)
    return replace(
        source,
        steps=tuple(sorted(steps)),
        skipped=skipped,
        gone=tuple((at, at + away, valve, signal) for at, away, valve, signal in gone),
    )


def retyped(rng, source):
    """Draw nodes whose type changes, some of them at a cut or a restart, as by a new program."""
    found = spread(
        rng,
        SIMULATED_S - CALM_S - 5.0,
        (0, 0, 1, 2),
        lambda: (
            rng.uniform(0.5, 12.0),
            rng.choice(source.valves),
            rng.choice(_RETYPED),
            rng.choice(TYPES),
        ),
    )
    moments = [at for at, *_ in (*source.cuts, *source.restarts)]
    if moments and rng.random() < 0.5:
        found = tuple((rng.choice(moments), *rest) for _, *rest in found)
    return replace(source, retyped=tuple((at, at + by, *rest) for at, by, *rest in found))


def step(rng):
    return rng.choice((-1.0, 1.0)) * rng.choice((1.0003, 60.0003, 3600.0003, 86_400.0003))


def _step_or_none(rng):
    return rng.choice((0.0, step(rng)))


def pause(rng):
    return rng.choice((0.1, 1.0, 9.0))


def spread(rng, until, counts, more):
    times = sorted(rng.uniform(1.0, until) for _ in range(rng.choice(counts)))
    return tuple((at, *more()) for at in times)
