"""Rows of `benchmarks.one_model`: samples of a circumstance, and where the map is asked.

Valves that `benchmarks.circumstances` does not have are here. *Inside* is within 5 % of U and 5 bar
of three samples at least.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from benchmarks import circumstances as c
from valvemap.model.samples import Samples
from valvemap.vocabulary.findings import FindingCode

SIX: Final = ("ordinary", "dead band", "S-shape", "eq. (7)", "saturating", "laminar")
MINUTES: Final = (5, 20, 60)
RATES: Final = (1, 10, 100)  # Hz
BOTH_WAYS: Final = (-100.0, 100.0)  # %

Flow = Callable[..., np.ndarray]


@dataclass(frozen=True)
class Row:
    """Samples of one seed; the true flow (U, dp) that is asked; where.

    Attributes
    ----------
    ends : (K,)
        Numbers of samples after which the map is asked.
    truths : (K,)
        The true flow at each of these moments.
    U_range, dp_range
        Of the valve, %, bar.
    sigma
        Of the noise, l/min.
    below
        Only smaller flows are asked, l/min.
    causes
        That there are.
    play
        Between U and the spool, %.
    changed
        Sample from which on the valve is another one, -1: never.
    """

    samples: Samples
    ends: tuple[int, ...]
    truths: tuple[Flow, ...]
    T: float = 40.0
    U_range: tuple[float, float] = (0.0, 100.0)
    dp_range: tuple[float, float] = (0.0, 200.0)
    sigma: float = c.SIGMA
    below: float = np.inf
    causes: frozenset[FindingCode] = frozenset()
    play: float = np.nan
    changed: int = -1


def both_ways(U, dp, lap=(3.0, 5.0), gain=(14.0, 9.0)):
    """Gains 14 and 9 l/min/√bar, dead band -3 … 5 %."""
    closing = gain[1] * np.clip((-U - lap[0]) / (100.0 - lap[0]), 0.0, 1.0)
    opening = gain[0] * np.clip((U - lap[1]) / (100.0 - lap[1]), 0.0, 1.0)
    return (opening - closing) * np.sqrt(np.abs(dp))


def compensated(U, dp, knee=10.0):
    """A pressure compensator: dp counts up to ``knee`` bar."""
    return 40.0 * np.clip((U - 4.0) / 96.0, 0.0, 1.0) * np.sqrt(np.minimum(dp, knee) / knee)


def overlapping(U, dp, lap):
    """A dead band of ``lap`` %, a gain of 13 l/min/√bar."""
    return 13.0 * np.clip((U - lap) / (100.0 - lap), 0.0, 1.0) * np.sqrt(dp)


def inside(row: Row, end: int, grid: int = 41) -> c.Region:
    """Points of a grid near at least three of the first ``end`` samples."""
    low, high = row.U_range
    span = (high - low) / 100.0
    U = (row.samples.U[:end] - low) / span
    parts = round(span)
    at = c.inside(U, row.samples.dp[:end], grid)
    if parts == 1:
        return at
    halves = [
        c.inside(row.samples.U[:end] - start, row.samples.dp[:end], grid)
        for start in np.arange(low, high, 100.0)
    ]
    starts = np.arange(low, high, 100.0)
    U = np.concatenate([h.U + start for h, start in zip(halves, starts, strict=True)])
    return c.Region(U, np.concatenate([h.dp for h in halves]))


def _points(seed, kind, N, U=(0.0, 100.0)):
    dp = (2.0, 198.0) if kind == "scattered" else (3.0, 195.0)
    return (c.scattered if kind == "scattered" else c.cycle)(seed, N, U, dp)


def plain(name, kind, N, seed):
    """A valve as it is."""
    valve = c.VALVES[name]
    U, dp = _points(seed, kind, N)
    return Row(c.samples_of(U, dp, valve(U, dp) + c.white(seed, N)), (N,), (valve,))


def two_ways(kind, N, seed):
    """U of both signs."""
    U, dp = _points(seed, kind, N, BOTH_WAYS)
    Q = both_ways(U, dp) + c.white(seed, N)
    return Row(c.samples_of(U, dp, Q), (N,), (both_ways,), U_range=BOTH_WAYS)


def knee(kind, N, seed):
    """A compensator."""
    U, dp = _points(seed, kind, N)
    Q = compensated(U, dp) + c.white(seed, N)
    causes = frozenset({FindingCode.COMPENSATOR})
    return Row(c.samples_of(U, dp, Q), (N,), (compensated,), causes=causes)


def coloured(name, N, seed):
    """Noise of AR(1), ρ = .95, on a cycle."""
    row = plain(name, "cycle", N, seed)
    U, dp = row.samples.U, row.samples.dp
    return replace(row, samples=c.samples_of(U, dp, row.truths[0](U, dp) + c.ar(seed, N)))


def spiked(name, kind, N, seed):
    """Spikes: .5 % of the samples anywhere in 0 … 180 l/min."""
    row = plain(name, kind, N, seed)
    rng, Q = np.random.default_rng([seed, 5]), row.samples.Q.copy()
    hit = rng.random(N) < 0.005
    Q[hit] = rng.uniform(0.0, 180.0, int(hit.sum()))
    return replace(row, samples=replace(row.samples, Q=Q))


def timed(U, dp, Q, fs):
    """Samples at ``fs`` Hz."""
    samples = c.samples_of(U, dp, Q)
    return replace(samples, t=(np.arange(len(U)) * (1e9 / fs)).astype(np.int64))


def _slow_cycle(seed, N, fs):
    """The machine's cycle at another sample rate."""
    every = round(c.FS / fs)
    U, dp = c.cycle(seed, N * every)
    return U[::every], dp[::every]


def fading(name, fs, seed, per_hour=-0.15):
    """A gain that drifts for an hour."""
    N = 3600 * fs
    U, dp = _slow_cycle(seed, N, fs)
    ends = tuple(60 * minutes * fs for minutes in MINUTES)
    valve, hours = c.VALVES[name], np.arange(N) / fs / 3600.0
    Q = valve(U, dp) * (1.0 + per_hour * hours) + c.white(seed, N)
    truths = tuple(partial(_times, valve, 1.0 + per_hour * end / fs / 3600.0) for end in ends)
    causes = frozenset({FindingCode.GAIN_DRIFT})
    return Row(timed(U, dp, Q, fs), ends, truths, causes=causes)


def growing(fs, seed, first=5.0, per_hour=4.0):
    """An overlap that grows for an hour."""
    N = 3600 * fs
    U, dp = _slow_cycle(seed, N, fs)
    ends = tuple(60 * minutes * fs for minutes in MINUTES)
    hours = np.arange(N) / fs / 3600.0
    Q = overlapping(U, dp, first + per_hour * hours) + c.white(seed, N)
    truths = tuple(partial(overlapping, lap=first + per_hour * end / fs / 3600.0) for end in ends)
    causes = frozenset({FindingCode.EDGE_DRIFT})
    return Row(timed(U, dp, Q, fs), ends, truths, causes=causes)


def wearing(name, worn, fs, seed):
    """An edge of which a part wears for an hour: ``worn(U, dp)`` more flow by then."""
    N = 3600 * fs
    U, dp = _slow_cycle(seed, N, fs)
    ends = tuple(60 * minutes * fs for minutes in MINUTES)
    valve = c.VALVES[name]
    Q = valve(U, dp) + np.arange(N) / N * worn(U, dp) + c.white(seed, N)
    truths = tuple(partial(_sum, valve, worn, end / N) for end in ends)
    return Row(timed(U, dp, Q, fs), ends, truths, causes=frozenset({FindingCode.WEAR}))


def _sum(valve, worn, share, U, dp):
    return valve(U, dp) + share * worn(U, dp)


def held(x, every):
    """A signal that is sampled with every n-th of the others."""
    return x[np.arange(len(x)) // every * every]


def held_back(name, which, every, seed, N=20_000):
    """U or the pressures sampled more slowly than Q."""
    U, dp = c.cycle(seed, N)
    valve = c.VALVES[name]
    Q = valve(U, dp) + c.white(seed, N)
    U = held(U, every) if "U" in which else U
    dp = held(dp, every) if "p" in which else dp
    return Row(c.samples_of(U, dp, Q), (N,), (valve,))


def held_all(name, how, causes, seed, N=20_000):
    """Signals that are published at different periods, or a command that moves in steps."""
    U, dp = c.cycle(seed, N)
    valve = c.VALVES[name]
    U, dp, Q = how(valve, U, dp, c.white(seed, N))
    return Row(c.samples_of(U, dp, Q), (N,), (valve,), causes=frozenset(causes))


def poppet(U, dp):
    """A poppet whose dead band falls with the pressure drop: 14 % at none, 6 % at 200 bar."""
    lap = 6.0 + 8.0 * np.exp(-dp / 60.0)
    return 13.0 * np.clip((U - lap) / (100.0 - lap), 0.0, 1.0) ** 1.1 * np.sqrt(dp)


def of_poppet(kind, N, seed):
    """That poppet."""
    U, dp = _points(seed, kind, N)
    return Row(c.samples_of(U, dp, poppet(U, dp) + c.white(seed, N)), (N,), (poppet,))


def damaged(name, seed, at=10_000, size=-0.1, after=(250, 8_000)):
    """-10 % of the flow, asked 250 and 8,000 samples later."""
    N = at + after[-1]
    U, dp = c.cycle(seed, N)
    valve = c.VALVES[name]
    Q = valve(U, dp) * (1.0 + size * (np.arange(N) >= at)) + c.white(seed, N)
    now = partial(_times, valve, 1.0 + size)
    causes = frozenset({FindingCode.GAIN_CHANGE})
    samples = c.samples_of(U, dp, Q)
    ends = tuple(at + later for later in after)
    return Row(samples, ends, (now,) * len(ends), causes=causes, changed=at)


def widened(name, seed, at=10_000, after=(500, 2_000, 10_000)):
    """A valve used in a tenth of its range, then in all of it."""
    N, valve = at + after[-1], c.VALVES[name]
    U, dp = c.cycle(seed, N)
    narrow = np.arange(N) < at
    U, dp = np.where(narrow, 40.0 + 0.1 * U, U), np.where(narrow, 90.0 + 0.1 * dp, dp)
    samples = c.samples_of(U, dp, valve(U, dp) + c.white(seed, N))
    return Row(samples, tuple(at + later for later in after), (valve,) * len(after))


def disturbed(name, how, seed, N=20_000):
    """A meter that fails four times: ``how(Q, first)`` writes its readings from then on."""
    row = plain(name, "cycle", N, seed)
    Q = row.samples.Q.copy()
    for first in (5_000, 9_000, 13_000, 17_000):
        how(Q, first)
    return replace(row, samples=replace(row.samples, Q=Q))


def shows_nothing(Q, first, samples=200):
    """A meter that shows no flow for a while."""
    Q[first : first + samples] = 0.0


def shows_nothing_long(Q, first):
    """The same for a minute, once."""
    if first == 9_000:
        shows_nothing(Q, first, 6_000)


def shows_the_last(Q, first, samples=300):
    """A meter that repeats its last reading for a while."""
    Q[first : first + samples] = Q[first - 1]


def behind(U, width):
    """A spool behind a play of ``width`` %."""
    spool, p = np.empty(len(U)), U[0]
    for i, u in enumerate(U.tolist()):
        p = min(max(p, u - width / 2.0), u + width / 2.0)
        spool[i] = p
    return spool


def slack(name, width, seed, N=20_000):
    """A spool with play; the truth is the middle of the loop."""
    U, dp = c.cycle(seed, N)
    valve = c.VALVES[name]
    samples = c.samples_of(U, dp, valve(behind(U, width), dp) + c.white(seed, N))
    return Row(samples, (N,), (valve,), causes=frozenset({FindingCode.PLAY}), play=width)


def averaged(Q, samples):
    """A meter that shows a moving average."""
    sums = np.cumsum(np.concatenate([np.full(samples, Q[0]), Q]))
    return (sums[samples:] - sums[:-samples]) / samples


def late(x, samples):
    """Dead time."""
    return np.concatenate([np.full(samples, x[0]), x[:-samples]])


def lagging(x, tau):
    """A first-order lag, s."""
    values, share = x.tolist(), 1.0 - np.exp(-1.0 / (c.FS * tau))
    for i in range(1, len(x)):
        values[i] = values[i - 1] + share * (values[i] - values[i - 1])
    return np.array(values)


def slipping(U, slip):
    """Friction: the spool moves once U is ``slip`` % off."""
    values, p = U.tolist(), U[0]
    for i, u in enumerate(values):
        p = u if abs(u - p) > slip else p
        values[i] = p
    return np.array(values)


def relays(U, width, many=40):
    """Preisach's hysteresis: a mean of plays."""
    return np.mean([behind(U, w) for w in np.linspace(0.0, 2.0 * width, many)], axis=0)


def shown(name, how, cause, seed, N=20_000, below=np.inf):
    """A valve whose flow is shown as ``how(valve, U, dp, noise)``."""
    U, dp = c.cycle(seed, N)
    valve = c.VALVES[name]
    samples = c.samples_of(U, dp, how(valve, U, dp, c.white(seed, N)))
    return Row(samples, (N,), (valve,), below=below, causes=frozenset(cause))


def ended_later(name, kind, seed, N=9_000, at=5_000):
    """A meter that ends at 80 l/min, where Δp is a fifth of its range until sample ``at``."""
    U, dp = _points(seed, kind, N)
    dp = np.where(np.arange(N) < at, 0.2 * dp, dp)
    valve = c.VALVES[name]
    samples = c.samples_of(U, dp, np.minimum(valve(U, dp), 80.0) + c.white(seed, N))
    return Row(samples, (N,), (valve,), below=75.0, causes=frozenset({FindingCode.METER_END}))


def choked(name, seed, N=20_000, share=0.7):
    """Δp counts up to a share of p1; p2 varies freely."""
    U, dp = c.cycle(seed, N)
    p2 = c.ramps_and_holds(np.random.default_rng([seed, 7]), N, 2.0, 60.0)
    valve = c.VALVES[name]
    Q = valve(U, np.minimum(dp, share * (dp + p2))) + c.white(seed, N)
    samples = replace(c.samples_of(U, dp, Q), p1=dp + p2, p2=p2)
    return Row(samples, (N,), (valve,), causes=frozenset({FindingCode.CHOKING}))


def pumped(name, seed, N=20_000, most=70.0):
    """A pump that delivers ``most`` l/min: beyond it the pressure drop collapses."""
    U, dp = c.cycle(seed, N)
    valve = c.VALVES[name]
    at_most = np.minimum(1.0, most / np.maximum(valve(U, dp), 1e-9))
    dp = dp * at_most**2
    samples = c.samples_of(U, dp, valve(U, dp) + c.white(seed, N))
    return Row(samples, (N,), (valve,), causes=frozenset({FindingCode.PUMP_LIMIT}))


def hidden(name, how, seed, N=20_000):
    """A flow that goes with something that is not measured, or that no operator describes."""
    U, dp = c.cycle(seed, N)
    valve = c.VALVES[name]
    samples = c.samples_of(U, dp, how(valve, U, dp, seed) + c.white(seed, N))
    return Row(samples, (N,), (valve,), causes=frozenset({FindingCode.MISFIT}))


def scaled(name, flows, pressures, seed, N=20_000):
    """Flows and pressures of another size; the noise as large a part."""
    row = plain(name, "cycle", N, seed)
    valve, dp = c.VALVES[name], pressures * row.samples.dp
    samples = c.samples_of(row.samples.U, dp, flows * row.samples.Q)
    return Row(
        samples,
        (N,),
        (partial(_of_other_size, valve, flows, pressures),),
        dp_range=(0.0, 200.0 * pressures),
        sigma=flows * c.SIGMA,
    )


def _of_other_size(valve, flows, pressures, U, dp):
    return flows * valve(U, dp / pressures)


def oily(U, dp, T):
    """A laminar edge that moves with the viscosity of ISO VG 46, leakage past closed lands."""
    thin = np.exp(-0.034 * (T - 40.0) + 1.3e-4 * (T - 40.0) ** 2)
    opening, half = np.clip((U - 5.0) / 95.0, 0.0, 1.0) ** 1.2, np.sqrt(thin)
    return 12.0 * opening * (np.sqrt(dp + half**2) - half) + 0.008 * dp / thin


def warmed(asked, seed, N=120_000):
    """Oil from 20 to 60 °C and back within 20 minutes."""
    U, dp = c.cycle(seed, N)
    T = 20.0 + 40.0 * np.sin(np.pi * np.arange(N) / N) ** 2
    samples = c.samples_of(U, dp, oily(U, dp, T) + c.white(seed, N), T)
    return Row(samples, (N,), (partial(oily, T=asked),), T=asked)


def _times(valve, factor, U, dp):
    return factor * valve(U, dp)


def moving(name, width, seed, seconds=(60, 200, 900)):
    """A spool with play, asked after these times."""
    row = slack(name, width, seed, round(seconds[-1] * c.FS))
    ends = tuple(round(s * c.FS) for s in seconds)
    return replace(row, ends=ends, truths=row.truths * len(ends))


def quantised(name, seed, N=20_000, of_U=0.4, of_dp=1.0):
    """U of 8 bits, pressures in whole bar."""
    row = plain(name, "cycle", N, seed)
    U, dp = (np.round(x / q) * q for x, q in ((row.samples.U, of_U), (row.samples.dp, of_dp)))
    return replace(row, samples=c.samples_of(U, dp, row.samples.Q))


def pulsed(name, seed, N=20_000, pulse=1e-4):
    """A gear meter: it shows the pulses, in l, between two samples."""
    row = plain(name, "cycle", N, seed)
    count = np.floor(np.cumsum(row.samples.Q) / (60.0 * c.FS * pulse))
    Q = 60.0 * c.FS * pulse * np.diff(count, prepend=0.0)
    return replace(row, samples=replace(row.samples, Q=Q))


def slowly(name, seed, N=3_000):
    """The machine's cycle at 1 Hz."""
    U, dp = _slow_cycle(seed, N, 1)
    valve = c.VALVES[name]
    return Row(timed(U, dp, valve(U, dp) + c.white(seed, N), 1), (N,), (valve,))


def of_reading(name, seed, N=20_000, share=0.01, least=0.05):
    """Noise of 1 % of the reading."""
    row = plain(name, "cycle", N, seed)
    Q = row.truths[0](row.samples.U, row.samples.dp)
    Q = Q + (share * np.abs(Q) + least) / c.SIGMA * c.white(seed, N)
    return replace(row, samples=replace(row.samples, Q=Q))


def together(seed, N=20_000):
    """Three or four circumstances at once, on a valve drawn for the seed."""
    rng = np.random.default_rng([seed, 11])
    lap, bend, gain = rng.uniform(2.0, 12.0), rng.uniform(0.9, 1.3), rng.uniform(8.0, 15.0)
    drawn = {TOGETHER[k] for k in rng.permutation(len(TOGETHER))[: rng.integers(3, 5)]}
    fade = rng.uniform(-0.2, 0.2) if FindingCode.GAIN_DRIFT in drawn else 0.0  # 1/h
    wide = rng.uniform(2.0, 5.0) if FindingCode.PLAY in drawn else 0.0
    warm = rng.uniform(10.0, 30.0) if "warm" in drawn else 0.0
    U, dp = c.cycle(seed, N)
    T = 40.0 + warm * np.arange(N) / N

    def valve(U, dp, T=40.0, hours=0.0):
        u = np.clip((U - lap) / (100.0 - lap), 0.0, 1.0) ** bend
        return (1.0 + fade * hours) * (1.0 + 2e-3 * (T - 40.0)) * gain * u * np.sqrt(dp)

    hours = np.arange(N) / c.FS / 3600.0
    late_U = late(U, round(rng.uniform(8, 20))) if FindingCode.DEAD_TIME in drawn else U
    Q = valve(behind(late_U, wide) if wide else late_U, dp, T, hours)
    Q = lagging(Q, rng.uniform(0.08, 0.25)) if FindingCode.LAG_Q in drawn else Q
    Q = Q + (c.ar(seed, N, 0.8) if "coloured" in drawn else c.white(seed, N))
    top = rng.uniform(0.6, 0.8) * Q.max() if FindingCode.METER_END in drawn else np.inf
    causes = frozenset(x for x in drawn if isinstance(x, FindingCode))
    samples, now = c.samples_of(U, dp, np.minimum(Q, top), T), T[-1]
    truth = partial(valve, T=now, hours=hours[-1])
    return Row(samples, (N,), (truth,), T=now, below=0.93 * top, causes=causes)


TOGETHER: Final = (
    *(FindingCode.GAIN_DRIFT, FindingCode.PLAY, FindingCode.DEAD_TIME, FindingCode.LAG_Q),
    *(FindingCode.METER_END, "warm", "coloured"),
)
SHOWN: Final = {
    "dead time .15 s": (
        lambda valve, U, dp, e: late(valve(U, dp), 15) + e,
        {FindingCode.DEAD_TIME},
        np.inf,
    ),
    "dead time of U .15 s": (
        lambda valve, U, dp, e: valve(late(U, 15), dp) + e,
        {FindingCode.DEAD_TIME},
        np.inf,
    ),
    "averaging 1 s": (
        lambda valve, U, dp, e: averaged(valve(U, dp) + e, 100),
        {FindingCode.AVERAGING},
        np.inf,
    ),
    "averaging .8 s before the noise": (
        lambda valve, U, dp, e: averaged(valve(U, dp), 80) + e,
        {FindingCode.AVERAGING},
        np.inf,
    ),
    "lag of U .1 s": (
        lambda valve, U, dp, e: valve(lagging(U, 0.1), dp) + e,
        {FindingCode.LAG_U},
        np.inf,
    ),
    "lag of Q .2 s": (
        lambda valve, U, dp, e: lagging(valve(U, dp), 0.2) + e,
        {FindingCode.LAG_Q},
        np.inf,
    ),
    "meter ends at 80": (
        lambda valve, U, dp, e: np.minimum(valve(U, dp) + e, 80.0),
        {FindingCode.METER_END},
        75.0,
    ),
    "meter dead below 3": (
        lambda valve, U, dp, e: np.where(valve(U, dp) + e < 3.0, 0.0, valve(U, dp) + e),
        {FindingCode.METER_START},
        np.inf,
    ),
    "friction 2 %": (
        lambda valve, U, dp, e: valve(slipping(U, 2.0), dp) + e,
        {FindingCode.HYSTERESIS},
        np.inf,
    ),
    "relays 3 %": (
        lambda valve, U, dp, e: valve(relays(U, 3.0), dp) + e,
        {FindingCode.HYSTERESIS},
        np.inf,
    ),
    "dead time of U, play 3 %, averaging .4 s": (
        lambda valve, U, dp, e: averaged(valve(behind(late(U, 10), 3.0), dp), 40) + e,
        {FindingCode.DEAD_TIME, FindingCode.PLAY, FindingCode.AVERAGING},
        np.inf,
    ),
}


HELD: Final = {
    "U held 7, p 10 samples": (
        lambda valve, U, dp, e: (held(U, 7), held(dp, 10), valve(U, dp) + e),
        set(),
    ),
    "Q held 10 samples": (
        lambda valve, U, dp, e: (U, dp, held(valve(U, dp) + e, 10)),
        set(),
    ),
    "U held 10 samples, dead time of U .15 s": (
        lambda valve, U, dp, e: (held(U, 10), dp, valve(late(U, 15), dp) + e),
        {FindingCode.DEAD_TIME},
    ),
    "U held 10 samples, averaging .4 s": (
        lambda valve, U, dp, e: (held(U, 10), dp, averaged(valve(U, dp), 40) + e),
        {FindingCode.AVERAGING},
    ),
    "U in steps of 10 samples, not held": (
        lambda valve, U, dp, e: (held(U, 10), dp, valve(held(U, 10), dp) + e),
        set(),
    ),
    "U in steps of 10 samples, not held, lag of U .05 s": (
        lambda valve, U, dp, e: (held(U, 10), dp, valve(lagging(held(U, 10), 0.05), dp) + e),
        {FindingCode.LAG_U},
    ),
}


def worn_near_closed(U, dp):
    """5 l/min more at 100 bar where the valve is closed, none from 15 % on."""
    return c.worn_edge(U, dp)


def worn_twice(U, dp):
    """Two spots: a groove at 30 %, a rounded edge at 70 %."""
    return (0.4 * np.exp(-(((U - 30) / 8) ** 2)) + 0.5 * np.exp(-(((U - 70) / 6) ** 2))) * np.sqrt(
        dp
    )


def worn_half_open(U, dp):
    """A notch that grows beyond 50 %."""
    return 0.01 * np.clip(U - 50.0, 0.0, 20.0) * np.sqrt(dp)


WORN: Final = {
    "near closed": worn_near_closed,
    "at two spots": worn_twice,
    "beyond 50 %": worn_half_open,
}


HIDDEN: Final = {
    "gain that swings": lambda valve, U, dp, _: (
        valve(U, dp) * (1.0 + 0.05 * np.sin(np.arange(len(U)) / c.FS / 12.0))
    ),
    "offset that wanders": lambda valve, U, dp, seed: (
        valve(U, dp) + c.ramps_and_holds(np.random.default_rng([seed, 8]), len(U), -3.0, 3.0)
    ),
    "flow by p2": lambda valve, U, dp, seed: (
        valve(U, dp) + 0.1 * c.ramps_and_holds(np.random.default_rng([seed, 7]), len(U), 2.0, 60.0)
    ),
    "flow by dp's rate": lambda valve, U, dp, _: valve(U, dp) + 0.05 * np.gradient(dp) * c.FS,
}


FAILING: Final = {
    "meter shows nothing for 2 s": shows_nothing,
    "meter shows nothing for 60 s": shows_nothing_long,
    "meter repeats a reading for 3 s": shows_the_last,
}

ROWS: Final[Mapping[str, Callable[[int], Row]]] = {
    **{
        f"{name}, {kind}, {N}": partial(plain, name, kind, N)
        for N in (3_000, 20_000)
        for kind in ("scattered", "cycle")
        for name in SIX
    },
    **{
        f"U of both signs, {kind}, {N}": partial(two_ways, kind, N)
        for kind in ("scattered", "cycle")
        for N in (3_000, 20_000)
    },
    "compensator's knee, cycle, 20000": partial(knee, "cycle", 20_000),
    "AR(.95), ordinary, cycle, 20000": partial(coloured, "ordinary", 20_000),
    **{
        f"spikes, ordinary, {kind}, 20000": partial(spiked, "ordinary", kind, 20_000)
        for kind in ("scattered", "cycle")
    },
    **{f"-15 %/h, ordinary, {fs} Hz": partial(fading, "ordinary", fs) for fs in RATES},
    **{f"overlap + 4 %/h, {fs} Hz": partial(growing, fs) for fs in RATES},
    **{
        f"worn {where}, ordinary, {fs} Hz": partial(wearing, "ordinary", worn, fs)
        for where, worn in WORN.items()
        for fs in (10, 100)
    },
    **{
        f"{which} held {every} samples, {name}": partial(held_back, name, which, every)
        for which in ("U", "p", "U and p")
        for every in (5, 10)
        for name in ("ordinary", "S-shape")
    },
    **{
        f"{what}, {name}": partial(held_all, name, how, causes)
        for what, (how, causes) in HELD.items()
        for name in ("ordinary", "S-shape")
    },
    **{
        f"poppet, {kind}, 20000": partial(of_poppet, kind, 20_000)
        for kind in ("scattered", "cycle")
    },
    "-10 %, ordinary, cycle": partial(damaged, "ordinary"),
    **{
        f"{size:+.0%}, {name}, cycle": partial(damaged, name, size=size)
        for size in (-0.6, 0.6)
        for name in ("ordinary", "S-shape")
    },
    **{f"narrow, then wide, {name}": partial(widened, name) for name in ("ordinary", "S-shape")},
    **{
        f"{what}, {name}": partial(disturbed, name, how)
        for what, how in FAILING.items()
        for name in ("ordinary", "S-shape")
    },
    **{f"oil 20-60-20 °C, asked at {T}": partial(warmed, float(T)) for T in (22, 30, 40, 50, 60)},
    **{
        f"play {width} %, {name}, cycle, 20000": partial(slack, name, width)
        for name in ("ordinary", "saturating")
        for width in (2, 4, 6)
    },
    **{
        f"play {width} %, ordinary, ramps and holds": partial(moving, "ordinary", width)
        for width in (0, 2, 4, 6)
    },
    "quantised U and p, ordinary, cycle, 20000": partial(quantised, "ordinary"),
    "gear meter's pulses, ordinary, cycle, 20000": partial(pulsed, "ordinary"),
    "noise of 1 % of reading, ordinary, cycle, 20000": partial(of_reading, "ordinary"),
    "1 Hz, ordinary, cycle, 3000": partial(slowly, "ordinary"),
    "three or four together": together,
    **{
        f"{what}, {name}": partial(shown, name, how, cause, below=below)
        for what, (how, cause, below) in SHOWN.items()
        for name in ("ordinary", "S-shape")
    },
    **{
        f"meter ends at 80 after 50 s, {name}, {kind}": partial(ended_later, name, kind)
        for name in ("ordinary", "S-shape")
        for kind in ("scattered", "cycle")
    },
    "choked, ordinary": partial(choked, "ordinary"),
    "pump limit, ordinary": partial(pumped, "ordinary"),
    **{f"{what}, ordinary": partial(hidden, "ordinary", how) for what, how in HIDDEN.items()},
    "flows × .01, ordinary": partial(scaled, "ordinary", 0.01, 1.0),
    "flows × 10, ordinary": partial(scaled, "ordinary", 10.0, 1.0),
    "Δp × 2, ordinary": partial(scaled, "ordinary", 1.0, 2.0),
}
