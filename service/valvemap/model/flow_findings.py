"""What a state of `FlowMap` finds to be the causes of what its samples show.

A log likelihood ratio g becomes the probability 1 / (1 + exp(-g)/odds) with the odds of a cause
before anything is known. What moves in time has the probability of its model, times that of gain
or edge being the one: each rate z standard deviations away from none weighs exp(z²/2).
"""

import math
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model import flow_map_looks
from valvemap.model.drift_states import covariance, drifting
from valvemap.model.flow_arrays import Both
from valvemap.model.flow_map_state import FlowMapState
from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_look
from valvemap.model.kernels import flow_memory as memory
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_play as plays
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels import flow_wear as wears
from valvemap.model.samples import Floats
from valvemap.vocabulary.findings import Finding, FindingCode

_CLOCKS: Final = slice(memory.CLOCK, memory.CLOCK + 2)
SECONDS_PER_HOUR: Final = 3600.0
SIDES: Final = "U ≥ 0", "U < 0"
OPERATORS: Final = {  # code; sentence of its size
    paths.DEAD_U: (FindingCode.DEAD_TIME, "The spool follows U after {:.3g} s."),
    paths.DEAD_Q: (FindingCode.DEAD_TIME, "The meter shows the flow of {:.3g} s ago."),
    paths.LAG_U: (FindingCode.LAG_U, "The spool lags U by a time constant of {:.3g} s."),
    paths.LAG_Q: (FindingCode.LAG_Q, "The meter lags the flow by a time constant of {:.3g} s."),
    paths.AVERAGE: (FindingCode.AVERAGING, "The meter shows a mean over {:.3g} s."),
    paths.STICK: (FindingCode.HYSTERESIS, "The spool moves once U is {:.3g} % off: friction."),
    paths.RELAYS: (FindingCode.HYSTERESIS, "The spool lags U by {:.3g} % either way, gradually."),
    paths.CHOKE: (FindingCode.CHOKING, "Δp counts up to {:.3g} times the pressure upstream."),
    paths.KNEE: (FindingCode.COMPENSATOR, "Δp counts up to {:.3g} bar."),
    paths.TOP: (FindingCode.METER_END, "The meter ends at {:.3g} l/min."),
    paths.NEWS: (FindingCode.REACTING_U, "U goes with the noise of the flow in the same sample."),
    paths.LEAST: (FindingCode.METER_START, "The meter shows no flow below {:.3g} l/min."),
}
LEVELS: Final = (  # code of its drift; unit; name; what to do
    (FindingCode.GAIN_DRIFT, "%", "gain", ""),
    (FindingCode.EDGE_DRIFT, "% of U", "edge", ""),
    (
        *(FindingCode.FLOW_ZERO, "l/min", "zero of the flow meter"),
        " The map is without it. Close the valve without Δp and compare the meter with 0.",
    ),
    (
        *(FindingCode.PRESSURE_ZERO, "bar", "zero of Δp"),
        " The map is without it. Relieve both lines and compare p1 and p2 with 0.",
    ),
)
CHANGES: Final = FindingCode.GAIN_CHANGE, FindingCode.EDGE_CHANGE  # a sensor's: as it drifts


def findings(state: FlowMapState, both: Both) -> tuple[Finding, ...]:
    """Causes of a probability above `rules.WORTH_SAYING`, the likeliest first."""
    if not state.counters[memory.FITTED]:
        return ()
    nameless = float(hidden(state))
    explained = 1.0 - nameless  # what drift or a change explains leaves nothing nameless
    found = [*_operators(state), *_pump(state), *_play(state)]
    scales = 100.0, 1.0, float(state.scalars[fits.ZERO_SCALE]), float(both[1].breaks[-1] ** 2)
    found += [*_moving(state, scales, explained), *_wearing(state, both, explained)]
    found += [*_changes(state, scales, explained), *_compensator(state, both)]
    found += [*_misfit(state, nameless)]
    likely = (one for one in found if one.probability > rules.WORTH_SAYING)
    return tuple(sorted(likely, key=lambda one: (-one.probability, one.code)))


def hidden(states: FlowMapState) -> Floats:
    """Probability that something moves the flow for which there is no name, of each model (…,)."""
    nameless = rules.CERTAIN * _wandered(states), _in_common(states), _surprising(states)
    return np.asarray(np.max(nameless, axis=0))


def _wandered(states: FlowMapState) -> NDArray[np.bool_]:
    """Whether gain or edge moved within the last hour as no drift and no change does (…,)."""
    last = states.counters[..., memory.WANDERED]
    since = 1e-9 * (states.counters[..., _CLOCKS].max(axis=-1) - last)
    return np.asarray((last != 0) & (since < rules.SAID_FOR))


def _in_common(states: FlowMapState) -> Floats:
    """Probability that errors in different cells are alike (…,), see `kernels.flow_look`."""
    rows = np.ascontiguousarray(states.scalars).reshape(-1, fits.SCALARS)
    found = np.empty(len(rows))
    flow_look.in_common_many(rows, found)
    return found.reshape(states.scalars.shape[:-1])


def _surprising(states: FlowMapState) -> Floats:
    """Stays in known cells are more surprising than all models allow."""
    excess = (states.scalars[..., fits.SURPRISE] - rules.SURPRISED) / rules.SURPRISE_STEP
    known = states.scalars[..., fits.STAYS_SEEN] >= rules.FEWEST_STAYS
    return np.asarray(known / (1.0 + np.exp(-np.clip(excess, -50.0, 50.0))))


def _probability(gain: float | Floats) -> Floats:
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(gain, -50.0, 50.0)) / rules.ODDS))


def _operators(state: FlowMapState) -> Iterator[Finding]:
    censored = int(state.counters[memory.CENSORED])
    for k, (code, sentence) in OPERATORS.items():
        size = float(state.path[k])
        if size > 0.0:
            text = sentence.format(size)
            if k in (paths.TOP, paths.LEAST):
                text = f"{text} {censored} samples there were not used."
            yield Finding(code, float(_probability(state.path[paths.GAINS + k])), text)


def _pump(state: FlowMapState) -> Iterator[Finding]:
    most, gain = (float(state.path[k]) for k in (paths.MOST, paths.MOST_GAIN))
    if gain >= rules.CLEAR and not state.path[paths.TOP]:
        text = f"The flow stays at {most:.3g} l/min while the valve opens and Δp falls."
        yield Finding(FindingCode.PUMP_LIMIT, float(_probability(gain)), text)


def _play(state: FlowMapState) -> Iterator[Finding]:
    width = 2.0 * float(state.play[plays.HALF])
    if width > 0.0:
        other = state.path[paths.HYSTERESIS] > 0.0
        code = FindingCode.HYSTERESIS if other else FindingCode.PLAY
        what = "A hysteresis" if other else "A play"
        yield Finding(
            code,
            float(_probability(rules.CLEAR)),
            f"{what} of {width:.2g} % lies between U and spool.",
        )


def _sides(state: FlowMapState) -> Iterator[tuple[int, str]]:
    for side, name in enumerate(SIDES):
        if state.counters[memory.CLOCK + side] != 0:
            yield side, name


def _moving(state: FlowMapState, scales: Sequence[float], explained: float) -> Iterator[Finding]:
    if state.counters[memory.USED] - state.counters[memory.BEGAN] < rules.SETTLED_MAP:
        return
    for side, name in _sides(state):
        moving = explained * float(drifting(state.chance[side]))
        m = drifts.MOVING + int(np.argmax(state.chance[side, drifts.MOVING : drifts.SENSING + 1]))
        x, P = state.x[side, m], covariance(state.P[side], m)
        rates = x[drifts.RATES :] * SECONDS_PER_HOUR
        stds = np.sqrt(np.diagonal(P)[drifts.RATES :]) * SECONDS_PER_HOUR
        for k, (code, unit, what, advice) in enumerate(LEVELS):
            scale = scales[k]
            share = float(_probability(0.5 * float(rates[k] / max(stds[k], 1e-12)) ** 2))
            size = f"{scale * rates[k]:+.3g} ± {scale * stds[k]:.2g} {unit} per hour"
            yield Finding(code, moving * share, f"The {what} at {name} drifts by {size}.{advice}")


def _wearing(state: FlowMapState, both: Both, explained: float) -> Iterator[Finding]:
    """Whether a part of an edge wears, and where it surely did of late."""
    for side, name in _sides(state):
        nodes, head = state.wear[side, : wears.NODES], state.wear[side, wears.NODES]
        moved = nodes[:, wears.LEVEL] - nodes[:, wears.FORMER]
        k = int(np.argmax(moved**2 / np.maximum(nodes[:, wears.P_LEVEL], 1e-300)))
        share = explained * float(head[wears.CHANCE])
        share *= 1.0 - float(drifting(state.chance[side]))  # that of a whole edge is no wear
        U = abs(both[0].breaks[-1 if side == 0 else 0]) * k / (wears.NODES - 1)
        size = f"{moved[k]:+.2g} l/min at the largest Δp"
        when = f"within some {rules.WEAR_RECALLED / 60.0:.0f} minutes"
        text = f"The flow near {U:.3g} % at {name} drifted by {size} {when}."
        yield Finding(FindingCode.WEAR, share, text)


def _changes(state: FlowMapState, scales: Sequence[float], explained: float) -> Iterator[Finding]:
    counters = state.counters
    since = 1e-9 * float(max(counters[memory.CLOCK : memory.CLOCK + 2]))
    since -= 1e-9 * float(counters[memory.CHANGE_TIME])
    of = float(state.stay[memory.CHANGE_OF])  # 0: it has no name
    if not counters[memory.CHANGES] or since > rules.SAID_FOR or of == 0.0:
        return
    side, kind = divmod(int(counters[memory.CHANGE_KIND]), drifts.NAMED)
    k = kind - drifts.OTHER_GAIN
    code, unit, what, advice = LEVELS[k]
    code = CHANGES[k] if k < len(CHANGES) else code
    size = f"{scales[k] * of:+.3g} {unit}"
    when = _utc(int(counters[memory.CHANGE_TIME]))
    text = f"The {what} at {SIDES[side % 2]} changed by {size} at {when} UTC.{advice}"
    yield Finding(code, rules.CERTAIN * explained, text)


def _compensator(state: FlowMapState, both: Both) -> Iterator[Finding]:
    """Whether the flow is the same at a fourth of a pressure drop."""
    if state.path[paths.KNEE] > 0.0:
        return
    high, top = both[0].breaks[-1], both[1].breaks[-1] ** 2
    U = np.repeat(high * np.array(rules.OPEN), 2)
    dp = np.tile(top * np.array(rules.FAR_APART), len(rules.OPEN))
    Q, std = flow_map_looks.predict(state, both, U, dp, np.full(len(U), np.nan))
    low, high_Q, doubt = Q[::2], Q[1::2], std[::2] + std[1::2]
    if not (np.isfinite(Q + std).all() and (low > doubt).all()):
        return
    rise = np.abs(high_Q / low - 1.0)
    if (rise + 2.0 * doubt / low < rules.HARDLY_RISES).all():
        share = float(np.mean(rise))
        text = f"From {dp[0]:.3g} to {dp[1]:.3g} bar the flow changes by {100 * share:.2g} % only."
        yield Finding(FindingCode.COMPENSATOR, rules.CERTAIN, text)


def _misfit(state: FlowMapState, nameless: float) -> Iterator[Finding]:
    left, noise = (float(state.scalars[k]) for k in (fits.MISFIT, fits.VARIANCE))
    if nameless > rules.WORTH_SAYING:
        size = math.sqrt(float(state.scalars[fits.SURPRISE]))
        text = f"Flows at known places differ {size:.2g} times as much as noise explains."
        if _wandered(state):
            when = _utc(int(state.counters[memory.WANDERED]))
            text = f"Something that is not measured moves the flow, at last at {when} UTC."
        yield Finding(FindingCode.MISFIT, nameless, text)
    elif left > noise > 0.0:
        text = f"Places differ from the smooth map by {left**0.5:.2g} l/min."
        yield Finding(FindingCode.MISFIT, left / (left + noise), text)


def _utc(t: int) -> str:
    return f"{datetime.fromtimestamp(1e-9 * float(t), UTC):%Y-%m-%d %H:%M:%S}"
