"""How signals come is found at the start, without a setting: together, in scans, on change."""

from itertools import pairwise

import numpy as np
import pytest

from support.plant import START, as_changes, plant
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.timing import Timing, TimingSettings, TimingState
from valvemap.pipeline.timing_words import STILL_NS
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.vocabulary.signals import Signal

MS = 1_000_000
FLOW = (Signal.U, Signal.P1, Signal.P2, Signal.Q)


def truth(t, rng, noise=0.3):
    """A plant that moves smoothly: U, p1, p2, Q at times t (ns since START)."""
    s = np.asarray(t) * 1e-9
    U = 50 + 35 * np.sin(0.9 * s) + 8 * np.sin(2.1 * s)
    p1 = 180 + 5 * np.sin(0.5 * s)
    p2 = 60 + 40 * np.sin(0.31 * s + 1)
    Q = 0.09 * U * np.sqrt(p1 - p2) + rng.normal(0, noise, np.shape(s))
    return U, p1, p2, Q


def changes_of(times, values, signals=FLOW):
    """Changes in the order of their time, of several signals."""
    item = np.concatenate(
        [np.full(len(t), j, np.int32) for t, j in zip(times, signals, strict=True)]
    )
    t, x = np.concatenate(times), np.concatenate(values)
    order = np.argsort(t, kind="stable")
    return DataChanges(item[order], x[order], np.zeros(len(t), np.uint32), START + t[order])


def skewed(n=600, step=20 * MS, skew=3 * MS, seed=5):
    """Each signal read and stamped 3 ms after the one before."""
    rng, at = np.random.default_rng(seed), np.arange(n) * step
    times = [at + k * skew for k in range(4)]
    values = [truth(t, rng)[k] for k, t in enumerate(times)]
    return changes_of(times, values), at


def of_one_instant(n=600, step=50 * MS, skew=3 * MS, seed=5):
    """A scan's values belong together; it is their stamps alone that lie apart."""
    rng, at = np.random.default_rng(seed), np.arange(n) * step
    U, dp = rng.uniform(5, 95, n), rng.uniform(20, 150, n)
    values = [U, dp + 5, np.full(n, 5.0), 0.1 * U * np.sqrt(dp) + rng.normal(0, 0.3, n)]
    return changes_of([at + k * skew for k in range(4)], values), at


def on_change(n=1200, step=50 * MS, seed=7, still=()):
    """What is written when it changes: U seldom, the pressures in steps, Q nearly always."""
    rng, at = np.random.default_rng(seed), np.arange(n) * step
    U = np.repeat(rng.uniform(5, 95, n // 10), 10)
    p1 = np.full(n, 200.0)
    p2 = np.repeat(rng.integers(10, 150, n // 4).astype(float), 4)
    Q = np.round(0.1 * U * np.sqrt(p1 - p2) + rng.normal(0, 0.2, n), 1)
    times, values = [], []
    for k, x in enumerate((U, p1, p2, Q)):
        new = np.concatenate([[True], np.diff(x) != 0])
        if k in still:
            new[1:] = False
        times.append(at[new] + (k % 2) * MS)  # in ms, a scan may end in the next one
        values.append(x[new])
    return changes_of(times, values), (U, p1, p2, Q)


def timing():
    return Timing(TimingSettings(), optional=((),))


def fed(changes, cuts=(), stage=None):
    """All that comes out, cut into batches at some places."""
    stage = stage or timing()
    edges = [0, *sorted(cuts), len(changes)]
    parts = [stage.take(changes[slice(a, b)]) for a, b in pairwise(edges)]
    return DataChanges.concatenate(parts), stage


def samples_of(out):
    align = Alignment(AlignmentSettings(), optional=((),))
    _, samples = align.update(align.initial_state(), out)
    return samples[0]


def columns(changes):
    return changes.item, changes.value, changes.status, changes.source_time


def test_signals_of_one_scan_are_brought_to_one_instant():
    changes, at = skewed()
    out, stage = fed(changes)
    found = samples_of(out)
    rng = np.random.default_rng(0)
    U, p1, p2, _ = truth(found.t - START, rng)
    assert len(found) > 0.95 * len(at)
    assert np.isin(found.t - START, at).all()
    assert np.abs(found.p1 - p1).max() < 0.01
    assert np.abs(found.p2 - p2).max() < 0.01
    assert np.array_equal(found.U, U)
    said = stage.valves[0].words.sentences({})
    assert said[0] == "U: with the scan's first"
    assert said[3] == "Q: 9 ms after the scan's first, interpolated"


def test_values_that_are_of_one_instant_stay_as_they_are():
    changes, at = of_one_instant()
    out, stage = fed(changes)
    found = samples_of(out)
    assert len(found) == len(at)
    assert np.array_equal(found.Q, changes.value[changes.item == Signal.Q][: len(found)])
    assert (
        stage.valves[0].words.sentences({})[2] == "p2: 6 ms after the scan's first, taken as it is"
    )


def test_a_step_within_a_scan_makes_no_sample_and_is_named():
    changes, _ = skewed(n=500)
    pressure = changes.item == Signal.P2
    steps = np.floor((changes.source_time - START) / (2500 * MS)) % 2
    value = np.where(pressure, 60 + 40 * steps, changes.value)
    out, stage = fed(DataChanges(changes.item, value, changes.status, changes.source_time))
    found = samples_of(out)
    assert set(found.p2) == {60.0, 100.0}
    said = stage.valves[0].words.losses({"p2": "p2 (ns=2;s=p2)"})
    assert any(
        one.startswith("p2 (ns=2;s=p2) moved too fast in 3 scans")
        and one.endswith("alignment.tolerance_ms = 12 takes it as it is")
        for one in said
    ), said


def test_what_comes_on_change_is_held():
    changes, (U, p1, p2, Q) = on_change()
    out, stage = fed(changes)
    found = samples_of(out)
    k = np.round((found.t - START) / (50 * MS)).astype(int)
    assert len(found) > 1000
    for name, column in (("U", U), ("p1", p1), ("p2", p2), ("Q", Q)):
        assert np.array_equal(getattr(found, name), column[k]), name
    assert stage.valves[0].words.sentences({})[0] == "U: on change, its last value is held"


@pytest.mark.parametrize("seed", range(4))
def test_values_lost_while_the_timing_is_detected_leave_the_samples_right(seed):
    changes, at = skewed(n=2000)
    rng = np.random.default_rng(seed)
    early = changes.source_time - START < 6_000 * MS
    lost = early & (changes.item != Signal.U) & (rng.random(len(changes)) < 0.1)
    out, stage = fed(changes[~lost])
    said = stage.valves[0].words.sentences({})[2]
    assert said.startswith("p2: on change, its last value is held, 6 ms after the scan's first")
    found = samples_of(out)
    late = found.t - START > 6_100 * MS
    _, p1, p2, _ = truth(found.t - START, np.random.default_rng(0))
    assert late.sum() > 0.95 * (at > 6_100 * MS).sum()
    assert np.abs(found.p1 - p1)[late].max() < 0.01
    assert np.abs(found.p2 - p2)[late].max() < 0.01


def test_a_signal_that_is_held_still_is_named():
    changes, _ = on_change(still=(1,))
    _, stage = fed(changes)
    assert (
        stage.valves[0]
        .words.still({"p1": "p1 (i=7)"})[0]
        .startswith("p1 (i=7) has stood still at 200 ")
    )
    assert int(changes.source_time[-1] - START) > STILL_NS


@pytest.mark.parametrize("make", [skewed, of_one_instant, on_change])
@pytest.mark.parametrize("seed", [0, 1])
def test_cut_as_you_like_the_same_comes_out(make, seed):
    changes, _ = make()
    whole, _ = fed(changes)
    rng = np.random.default_rng(seed)
    cuts = np.unique(rng.integers(1, len(changes), 1 + 400 * seed))
    parts, _ = fed(changes, cuts.tolist())
    for one, other in zip(columns(whole), columns(parts), strict=True):
        assert np.array_equal(one, other)


def published(changes, every, late=0):
    """Changes as most servers send them: a message every ``every`` ns, in it signal by signal."""
    message = (changes.source_time - START + late) // every
    order = np.lexsort((changes.source_time, changes.item, message))
    return DataChanges(*(column[order] for column in columns(changes)))


@pytest.mark.parametrize("make", [skewed, of_one_instant, on_change])
@pytest.mark.parametrize("every", [100 * MS, 400 * MS, 900 * MS])
def test_a_message_sorted_by_signal_is_understood_as_one_in_order_of_time(make, every):
    changes, _ = make()
    expected = fed(changes)[1].valves[0].found.comes
    for late in np.arange(0, every, every // 7):
        _, stage = fed(published(changes, every, int(late)))
        assert np.array_equal(stage.valves[0].found.comes, expected), late


@pytest.mark.parametrize("make", [skewed, on_change])
@pytest.mark.parametrize("share", [0.05, 0.3, 0.7])
def test_a_restart_changes_nothing(make, share):
    changes, _ = make()
    at = int(share * len(changes))
    whole, _ = fed(changes)
    first, stage = fed(changes[slice(0, at)])
    packed = stage.valves[0].state.to_bytes("key")
    again = timing()
    again.put(0, TimingState.from_bytes(packed, "key"))
    rest, _ = fed(changes[slice(at, None)], stage=again)
    both = DataChanges.concatenate([first, rest])
    for one, other in zip(columns(whole), columns(both), strict=True):
        assert np.array_equal(one, other)


def test_signals_that_carry_one_time_pass_as_they_come():
    changes = as_changes(plant(300))
    stage = Timing(TimingSettings(), optional=(("T",),), has_sequence=(True,))
    out, _ = fed(changes, [6, 12, 900], stage)
    for one, other in zip(columns(changes), columns(out), strict=True):
        assert np.array_equal(one, other)
    assert stage.valves[0].words.sentences({}) == ("the signals of a sample carry one time",)
    assert stage.take(changes) is changes


def test_now_and_then_one_time_does_not_deceive():
    """Stamped in ms, two writes of a source on change often fall into one ms."""
    changes, (U, _, _, _) = on_change()
    early = changes.source_time < START + 40 * MS
    time = np.where(early, START, changes.source_time)
    out, stage = fed(DataChanges(changes.item, changes.value, changes.status, time))
    assert stage.valves[0].found is not None
    found = samples_of(out)
    k = np.round((found.t - START) / (50 * MS)).astype(int)
    assert np.array_equal(found.U, U[k])
    assert len(found) > 900


def test_the_state_of_a_valve_is_kept_with_what_was_found():
    plan = ValvePlan("V1", QualityGate(), {"RLS": RecursiveLeastSquares()}, "RLS")

    def fresh():
        return Identification([plan], Alignment(AlignmentSettings(), optional=((),)), timing())

    changes, _ = skewed()
    whole, first, second = fresh(), fresh(), fresh()
    whole.take(changes)
    first.take(changes[slice(0, 1500)])
    restored, refused = second.restore([*first.states.checkpoints(), *first.states.memories()])
    assert not refused
    assert "V1.Signals" in restored
    second.take(changes[slice(1500, None)])
    assert np.array_equal(
        second.results.one(0).estimators["RLS"].theta, whole.results.one(0).estimators["RLS"].theta
    )
    assert second.timing(0) == whole.timing(0)
    assert whole.results.one(0).estimators["RLS"].sample_count > 550


def test_what_waits_leaves_where_nothing_more_comes():
    changes, _ = on_change()
    _, stage = fed(changes)
    assert stage.pending[0] > 0
    assert len(stage.flush(np.zeros(1, np.int64))) > 0
    assert stage.pending[0] == 0


def with_deadbands(bands, n=4000, step=50 * MS, seed=3):
    """Smooth signals that are written when they have left a band around what was written last."""
    rng, at = np.random.default_rng(seed), np.arange(n) * step
    U = np.repeat(rng.uniform(20, 80, n // 10), 10)
    p1 = 190 + 8 * np.sin(at * 0.4e-9)
    p2 = 60 + 40 * np.sin(at * 0.31e-9)
    Q = 0.1 * U * np.sqrt(p1 - p2) + rng.normal(0, 0.2, n)
    times, values = [], []
    for x, band in zip((U, p1, p2, Q), bands, strict=True):
        last, new = np.inf, np.zeros(n, np.bool_)
        for i, value in enumerate(x):
            if abs(value - last) > band:
                last, new[i] = value, True
        times.append(at[new])
        values.append(x[new])
    return changes_of(times, values)


def test_the_deadband_of_a_source_enters_the_interval_of_the_flow():
    plan = ValvePlan("V1", QualityGate(), {"RLS": RecursiveLeastSquares()}, "RLS")
    found = {}
    for bands in ((0.0, 0.0, 0.0, 0.0), (0.0, 0.8, 1.5, 0.0)):
        align = Alignment(AlignmentSettings(), optional=((),))
        identification = Identification([plan], align, timing())
        identification.take(with_deadbands(bands))
        _, std, _ = identification.predict("V1", "RLS", 50.0, 100.0, 40.0)
        found[bands] = std, identification
    (sharp, _), (wide, identification) = found.values()
    slope = 0.1 * 50.0 / (2.0 * np.sqrt(100.0))
    expected = slope * np.hypot(0.8, 1.5) / np.sqrt(3.0)  # uniform within the bands
    assert wide > sharp
    assert np.sqrt(wide**2 - sharp**2) == pytest.approx(expected, rel=0.25)
    assert "steps from" in identification.timing(0)[Signal.P2]
    assert np.isfinite(identification.results.one(0).estimators["RLS"].systematic_std)
    again = Identification([plan], Alignment(AlignmentSettings(), optional=((),)), timing())
    _, refused = again.restore(
        [*identification.states.checkpoints(), *identification.states.memories()]
    )
    assert not refused
    assert again.predict("V1", "RLS", 50.0, 100.0, 40.0)[1] == wide
