"""One axis: lines meet, jobs are due, a refusal harms no map, and a state goes on bit for bit."""

import dataclasses

import numpy as np
import pytest

from valvemap.model.axis import AxisGeometry, AxisRegression, AxisSamples, AxisState
from valvemap.model.axis_search import AxisResult, fitted
from valvemap.model.estimator import StateMismatchError
from valvemap.model.samples import Samples
from valvemap.pipeline import axis_learner, axis_searches, kept_axes
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.axis_searches import SEARCHES_S, Searches
from valvemap.pipeline.edges import MOST_WAITING
from valvemap.vocabulary.statuses import AxisStatus, InverseStatus, Quality
from valvemap_rig.directional import DirectionalValve
from valvemap_rig.machine import Machine
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import Commands, advance, initial

GEOMETRY = AxisGeometry(63, 45, 800, 1.2, 1.2)
PLAN = AxisPlan("Press", GEOMETRY, 600.0)
KNOWN = AxisRegression(GEOMETRY, play_percent=2.0, spool_hz=40.0, memory_s=PLAN.memory_s)
SIGNALS = ("U", "x", "pA", "pB", "pS", "pT", "T")


@pytest.fixture(scope="module")
def samples():
    valve = DirectionalValve(leakage_l_min_bar=0.0, play_percent=2.0)
    machine = Machine(name="Axis", measures="position", valve=valve)
    scenario = Scenario(valves=(), machines=(machine,))
    _, block = advance(scenario, initial(scenario, 0), 12_000, Commands())
    shown = block.machines["Axis"].shown
    return AxisSamples.of(block.t, **{name: shown[name] for name in SIGNALS})


@pytest.fixture(scope="module")
def found(samples):
    """The outcome of a search, with the rig's play and spool."""
    state, fit = fitted(KNOWN, samples[:7_000])
    return AxisResult(AxisStatus.OK, "", fit, {}, state, np.zeros_like(fit.covariance))


@pytest.fixture
def axis(samples, found, monkeypatch):
    monkeypatch.setattr(axis_learner, "identify", lambda *_, **__: found)
    one = Axis(PLAN)
    for start in range(0, 7_100, 100):
        one.take(samples[start : start + 100])
    return one


def lines_of(samples, quality=None):
    n = len(samples)
    quality = np.zeros(n, np.uint8) if quality is None else quality
    for p1, p2 in ((samples.pS, samples.pA), (samples.pB, samples.pT)):
        yield Samples(
            t=samples.t, U=samples.U, p1=p1, p2=p2, Q=samples.x, T=samples.T, quality=quality
        )


def done(axis):
    names = []
    while (job := axis.learner.job()) is not None:
        outcome = job()
        axis.learner.accept(outcome)
        names.append(type(outcome).__name__)
    return names


def test_a_search_is_due_after_seventy_seconds_and_then_the_map_is_solved(samples, axis):
    early = Axis(PLAN)
    early.take(samples[:6_900])
    assert early.learner.job() is None
    assert early.results().status is AxisStatus.TOO_SHORT
    assert done(axis) == ["AxisResult", "Known"]
    results = axis.results()
    assert results.status is AxisStatus.OK
    assert results.map.bulk_modulus[0] == pytest.approx(0.9, rel=0.1)
    assert results.used_s > 60.0


def test_one_job_at_a_time_and_its_samples_are_not_lost(samples, axis, found):
    job = axis.learner.job()
    assert axis.learner.job() is None
    axis.take(samples[7_100:9_000])
    axis.learner.accept(job())
    done(axis)
    whole, _ = KNOWN.update(found.state, samples[7_100:9_000])
    assert whole.M.tobytes() == axis.learner.state.M.tobytes()


def due():
    """Searches of which the next is due."""
    return Searches(left_s=0.0)


def test_a_refused_search_keeps_the_map_that_there_is(samples, axis, found, monkeypatch):
    done(axis)
    refused = dataclasses.replace(found, status=AxisStatus.TOO_SHORT, sentence="too short")
    monkeypatch.setattr(axis_learner, "identify", lambda *_, **__: refused)
    before = axis.results().map
    for start in range(7_100, 12_000, 100):
        axis.take(samples[start : start + 100])
        axis.learner.searches = due()
        done(axis)
    assert axis.results().status is AxisStatus.OK
    assert axis.results().map.U.tolist() == before.U.tolist()
    afresh = Axis(PLAN)
    afresh.take(samples[:100])
    afresh.learner.searches = due()
    done(afresh)
    assert (afresh.results().status, afresh.results().sentence) == (
        AxisStatus.TOO_SHORT,
        "too short",
    )


def test_lines_meet_however_they_are_cut_and_bad_samples_are_left_out(samples):
    quality = np.zeros(600, np.uint8)
    quality[200:210] = Quality.BAD
    part = samples[:600]
    line_A, line_B = lines_of(part, quality)
    one = Axis(PLAN)
    for start, end in ((0, 100), (100, 450), (450, 600)):
        one.take_line(0, line_A[start:end])
    for start, end in ((0, 250), (250, 260), (270, 600)):  # ten never come
        one.take_line(1, line_B[start:end])
    whole = one.learner.window.whole()
    assert len(whole) == 590
    assert np.isnan(whole.pA[200:210]).all()
    good = np.delete(np.arange(600), np.r_[200:210, 260:270])
    for name in SIGNALS[:-1]:
        shown = np.delete(getattr(whole, name), slice(200, 210))
        assert shown.tolist() == getattr(part, name)[good].tolist(), name


def test_the_fifth_signal_of_an_axis_of_speed_is_its_speed(samples):
    one = Axis(dataclasses.replace(PLAN, has_speed=True))
    v = np.gradient(samples.x, 0.01)
    for line, part in enumerate(lines_of(dataclasses.replace(samples, x=v)[:600])):
        one.take_line(line, part)
    whole = one.learner.window.whole()
    assert whole.v.tolist() == v[:600].tolist()
    assert (whole.x[0], whole.x.min() >= 0.0, whole.x.max() <= 800.0) == (400.0, True, True)


def test_samples_of_one_line_alone_do_not_pile_up(samples):
    one = Axis(PLAN)
    line_A, _ = lines_of(samples)
    for start in range(0, 12_000, 1_000):
        one.take_line(0, line_A[start : start + 1_000])
    assert len(one._unmet[0].t) == MOST_WAITING
    assert one.learner.job() is None


def test_after_a_sudden_change_play_and_spool_are_searched_in_what_comes_then(
    samples, axis, monkeypatch
):
    done(axis)
    changed = iter([False, True, True, True])
    monkeypatch.setattr(AxisState, "has_changed", property(lambda _: next(changed)))
    axis.take(samples[7_100:7_200])
    axis.take(samples[7_200:7_300])
    assert len(axis.learner.window) == 100
    assert axis.learner.searches.left_s == pytest.approx(SEARCHES_S[0], abs=1.1)
    assert axis.results().map is not None


def at_rest(samples, seconds):
    """The axis at its last place, for so long, from the next sample on."""
    n, last = round(100 * seconds), samples[-1:]
    rng = np.random.default_rng(3)
    held = {name: np.full(n, getattr(last, name)[0]) for name in SIGNALS}
    held["U"][:], held["x"] = 0.0, held["x"] + 0.5 * rng.standard_normal(n)
    return AxisSamples.of(last.t[0] + 10_000_000 * np.arange(1, n + 1), **held)


def test_a_resting_axis_neither_searches_nor_forgets(samples, axis):
    done(axis)
    before, kept_s = axis.results(), axis.learner.searches.left_s
    rest = at_rest(samples[:7_100], 3_600)
    for start in range(0, len(rest), 1_000):
        axis.take(rest[start : start + 1_000])
        assert done(axis) in ([], ["Known"])
    after = axis.results()
    assert after.t == rest.t[-1]
    assert after.used_s - before.used_s < 60.0
    assert kept_s - axis.learner.searches.left_s < 60.0
    assert after.map.known.tolist() == pytest.approx(before.map.known.tolist(), abs=5.0)


def test_refused_searches_become_rare(samples, found, monkeypatch):
    refused = dataclasses.replace(found, status=AxisStatus.BULK_MODULUS, sentence="too soft")
    monkeypatch.setattr(axis_learner, "identify", lambda *_, **__: refused)
    one, waits = Axis(PLAN), []
    for _ in range(7):
        one.take(samples[:100])
        one.learner.searches = dataclasses.replace(one.learner.searches, left_s=0.0)
        done(one)
        waits.append(one.learner.searches.left_s)
    assert waits == [30.0, 60.0, 120.0, 240.0, 480.0, 600.0, 600.0]


def test_a_state_goes_on_with_the_same_bits(samples, axis):
    done(axis)
    packed, again = axis.to_bytes()[kept_axes.LEARNT], Axis(PLAN)
    again.resume(kept_axes.LEARNT, packed)
    assert done(again) == ["Known"]
    assert again.results().status is AxisStatus.OK
    for one in (axis, again):
        one.take(samples[7_100:9_000])
    for name, array in vars(axis.learner.state).items():
        assert array.tobytes() == getattr(again.learner.state, name).tobytes(), name
    other = dataclasses.replace(PLAN.geometry, rod_mm=40.0)
    with pytest.raises(StateMismatchError, match="other hyper-parameters"):
        Axis(dataclasses.replace(PLAN, geometry=other)).resume(kept_axes.LEARNT, packed)
    with pytest.raises(StateMismatchError):
        Axis(PLAN).resume(kept_axes.LEARNT, packed[:-100])


def test_after_a_restart_the_searches_go_on_where_they_were(samples, axis):
    done(axis)
    axis.learner.searches = Searches(found=3, left_s=400.0)
    again = Axis(PLAN)
    for name, packed in axis.to_bytes().items():
        again.resume(name, packed)
    assert done(again) == ["Known"]
    assert again.learner.searches == Searches(found=2, left_s=400.0)
    again.take(samples[7_100:9_000])
    assert done(again) == ["Known"]


def test_a_search_after_a_restart_has_as_many_samples_as_without_it():
    for found, window_s in enumerate(SEARCHES_S):
        assert Searches(found=found, left_s=1.0).resumed().left_s == window_s


def watched(axis, samples):
    """Feed samples second by second, doing what is due."""
    for start in range(0, len(samples), 100):
        axis.take(samples[start : start + 100])
        done(axis)
    return axis.results()


@pytest.fixture
def reference(samples, axis, monkeypatch):
    """An axis whose play and spool are settled, so that its map is the reference of findings."""
    monkeypatch.setattr(axis_searches, "SEARCHES_S", (70.0,))
    assert axis.results().findings is None
    done(axis)
    return axis


def damaged(samples, share=0.9):
    """The work as if the piston moved more slowly while it extends: PA and BT pass less."""
    v = np.diff(samples.x, prepend=samples.x[0])
    x = np.clip(samples.x[0] + np.cumsum(np.where(v > 0.0, share * v, v)), 5.0, 795.0)
    return dataclasses.replace(samples, x=x)


def test_a_change_is_found_kept_over_a_restart_and_gone_with_a_new_reference(samples, reference):
    healthy = watched(reference, samples[7_100:9_500])
    assert healthy.findings == ()
    changed = watched(reference, damaged(samples[9_500:]))
    assert changed.findings
    assert changed.findings[0].probability > 0.5
    again = Axis(PLAN)
    for name, packed in reference.to_bytes().items():
        again.resume(name, packed)
    assert again.results().findings == changed.findings
    reference.learner.set_reference()
    assert reference.results().findings is None
    assert reference.results().map is not None
    assert reference.to_bytes() == {}


def test_a_weighing_under_way_loses_no_window_and_outlives_no_reference(samples, reference):
    one = reference
    for start in range(7_100, 8_300, 100):
        one.take(samples[start : start + 100])
        if one.learner.watch.closed:
            break
    one.learner._to_refit_s = 1e9
    job = one.learner.job()
    for later in range(start + 100, start + 1_300, 100):
        one.take(samples[later : later + 100])
    running = one.learner.watch.running
    one.learner.accept(job())
    assert len(one.learner.watch.closed) == 1
    assert one.learner.watch.running.flow.M.tobytes() == running.flow.M.tobytes()
    job = one.learner.job()
    one.learner.set_reference()
    one.learner.accept(job())
    assert one.results().findings is None


def test_a_damaged_reference_is_refused_and_the_map_is_not(reference):
    packed = reference.to_bytes()
    again = Axis(PLAN)
    with pytest.raises(StateMismatchError):
        again.resume(kept_axes.WATCH, packed[kept_axes.WATCH][:-100])
    again.resume(kept_axes.LEARNT, packed[kept_axes.LEARNT])
    assert done(again) == ["Known"]


def test_u_is_approached_from_the_side_of_the_demand(axis):
    done(axis)
    table = dataclasses.replace(axis.learner.known.table, play_percent=4.0)
    axis.learner.known = dataclasses.replace(axis.learner.known, table=table)
    axis.demand(50.0)
    axis.required()
    middle = axis.invert(100.0).U
    axis.demand(100.0)
    rising = axis.required()
    axis.demand(20.0)
    axis.required()
    axis.demand(10.0)
    falling = axis.required()
    assert abs(rising.U - middle - 2.0) < 1e-9
    assert rising.status is InverseStatus.OK
    assert abs(falling.U - axis.invert(10.0).U + 2.0) < 1e-9
    axis.demand(np.nan)
    assert axis.required().status is InverseStatus.NOT_FINITE
