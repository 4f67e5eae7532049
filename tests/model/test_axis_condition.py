"""Causes of an axis's changes: told apart on the rig, by hand where a closed form is known."""

import math
from dataclasses import replace

import numpy as np
import pytest

from valvemap.model.axis import AxisGeometry, AxisRegression, AxisSamples
from valvemap.model.axis_basis import SIZE
from valvemap.model.axis_condition import (
    CAUSES,
    HYPOTHESES,
    Condition,
    Reference,
    WindowSums,
    weigh,
)
from valvemap.model.axis_fit import with_theta
from valvemap.model.axis_search import fitted
from valvemap.vocabulary.findings import FindingCode
from valvemap_rig.directional import DirectionalValve
from valvemap_rig.faults import Fault
from valvemap_rig.machine import Machine
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import Commands, advance, initial

GEOMETRY = AxisGeometry(63, 45, 800, 1.2, 1.2)
KNOWN = AxisRegression(GEOMETRY, play_percent=2.0, spool_hz=40.0)
FAULTS = {
    FindingCode.PA_CHANGE: Fault(kind="damage", edge="PA", size=-10),
    FindingCode.AT_CHANGE: Fault(kind="damage", edge="AT", size=-10),
    FindingCode.PB_CHANGE: Fault(kind="damage", edge="PB", size=10),
    FindingCode.BT_CHANGE: Fault(kind="damage", edge="BT", size=-10),
    FindingCode.LEAKAGE_CHANGE: Fault(kind="leakage", size=2),
    FindingCode.AIR: Fault(kind="air", size=5),
    FindingCode.MISFIT: Fault(kind="lag", signal="x", size=0.1),
}


@pytest.fixture(scope="module")
def rig():
    valve = DirectionalValve(leakage_l_min_bar=0.0, play_percent=2.0)
    machine = Machine(name="Axis", measures="position", valve=valve)
    return Scenario(valves=(), machines=(machine,))


def played(scenario, state, seconds, *faults):
    commands = Commands(faults=tuple(("Axis", fault) for fault in faults))
    state, block = advance(scenario, state, round(100 * seconds), commands)
    return state, AxisSamples.of(block.t, **block.machines["Axis"].shown)


@pytest.fixture(scope="module")
def known(rig):
    """The rig after 150 s, the state of the regression, and the reference."""
    after, samples = played(rig, initial(rig, 0), 150)
    state, found = fitted(KNOWN, samples)
    return after, with_theta(state, found.theta), Reference.of(found)


def window(state, samples):
    names = ("M", "b", "squares", "errors", "score", "scores")
    empty = replace(state, **{name: np.zeros_like(getattr(state, name)) for name in names})
    after, _ = KNOWN.update(empty, samples)
    return after, WindowSums.of(after)


def condition_after(rig, known, *faults, seconds=20):
    after, state, reference = known
    _, samples = played(rig, after, seconds, *faults)
    condition = Condition.initial()
    for start in range(0, len(samples), 1_000):
        state, sums = window(state, samples[start : start + 1_000])
        condition = condition.after(reference, sums, 10.0)
    return condition


@pytest.mark.parametrize("code", FAULTS)
def test_each_cause_is_told_after_twenty_seconds(rig, known, code):
    first, *others = condition_after(rig, known, FAULTS[code]).findings()
    assert first.code is code
    assert first.probability > 0.9
    assert not others


def test_sizes_are_the_rigs(rig, known):
    (edge,) = condition_after(rig, known, FAULTS[FindingCode.PA_CHANGE]).findings()
    assert edge.sentence == "The edge PA passes 10 ± 0.9 % less than before."
    condition = condition_after(rig, known, FAULTS[FindingCode.LEAKAGE_CHANGE])
    more = condition.size[CAUSES.index(FindingCode.LEAKAGE_CHANGE), 0]
    assert more == pytest.approx(0.004, rel=0.2)  # l/min/bar
    (leak,) = condition.findings()
    assert "more than before" in leak.sentence


@pytest.mark.parametrize("size", [-10, -30])
def test_two_edges_at_once_are_both_named_with_their_sizes(rig, known, size):
    both = [Fault(kind="damage", edge=edge, size=size) for edge in ("PA", "BT")]
    found = condition_after(rig, known, *both).findings()
    assert {one.code for one in found} == {FindingCode.PA_CHANGE, FindingCode.BT_CHANGE}
    for one in found:
        assert one.probability > 0.9
        passes = int(one.sentence.split("passes ")[1].split(" ")[0])
        assert passes == pytest.approx(-size, abs=2)
        assert "less than before" in one.sentence


def test_without_a_change_nothing_is_found(rig, known):
    condition = condition_after(rig, known, seconds=60)
    assert condition.findings() == ()
    assert condition.unchanged > 0.999


def test_a_repair_is_seen(rig, known):
    after, state, reference = known
    condition = Condition.initial()
    broken, damaged = played(rig, after, 20, Fault(kind="damage", edge="PA", size=-10))
    del broken
    _, healthy = played(rig, after, 60)
    parts = [healthy[k : k + 1_000] for k in range(0, 6_000, 1_000)]
    for part in (damaged[:1_000], damaged[1_000:], *parts):
        state, sums = window(state, part)
        condition = condition.after(reference, sums, 10.0)
    assert condition.unchanged > 0.99


def test_no_rows_tell_nothing(known):
    _, _, reference = known
    nothing = WindowSums(np.zeros((SIZE, SIZE)), np.zeros(SIZE), 0.0, 0.0)
    condition = Condition.initial()
    weighed = weigh(reference, nothing, condition.mean, condition.spread)
    but_friction = np.delete(weighed.log_evidence, 1 + CAUSES.index(FindingCode.FRICTION))
    assert but_friction == pytest.approx(np.zeros(len(HYPOTHESES)), abs=1e-6)
    for _ in range(36):
        condition = condition.after(reference, nothing, 100.0)
    but_friction = (len(CAUSES) - 1) / len(CAUSES)  # without forces, friction is excluded
    expected = math.exp(-3600 * but_friction / 360_000)
    assert condition.unchanged == pytest.approx(expected, abs=1e-3)


def test_an_exact_reference_gives_the_evidence_of_one_regressor():
    """With P₀ → 0 and rows along θ₀ of edge PA: the Bayes factor of a regression by hand."""
    theta = np.zeros(SIZE)
    theta[5] = 2.0  # of PA
    reference = Reference(theta, 1e12 * np.eye(SIZE), 0.04, 1.0)
    rng = np.random.default_rng(1)
    x, n = rng.uniform(0.5, 1.5, 400), 400
    y = 2.0 * 0.95 * x + 0.2 * rng.standard_normal(n)
    M, b = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    M[5, 5], b[5] = x @ x, x @ y
    prior = Condition.initial()
    sums = WindowSums(M, b, float(y @ y), float(n))
    weighed = weigh(reference, sums, prior.mean, prior.spread)
    s, freedom = 0.1 * 2.0, 10.0  # prior of the coefficient; degrees of freedom of the noise
    residual = y - 2.0 * x
    J = x @ x / 0.04
    B = 1.0 + s * s * J
    chi0 = residual @ residual / 0.04
    chi1 = chi0 - (s * (x @ residual) / 0.04) ** 2 / B
    by_hand = -0.5 * math.log(B) - 0.5 * (freedom + n) * (
        math.log1p(chi1 / freedom) - math.log1p(chi0 / freedom)
    )
    found = weighed.log_evidence
    assert found[1] - found[0] == pytest.approx(by_hand, rel=1e-6)
    assert weighed.size[0, 0] == pytest.approx(-0.05, abs=0.01)


@pytest.mark.parametrize("absurd", [np.nan, np.inf, 1e308])
def test_absurd_sums_change_no_condition(known, absurd):
    _, _, reference = known
    sums = WindowSums(np.full((SIZE, SIZE), absurd), np.full(SIZE, absurd), absurd, 500.0)
    condition = Condition.initial()
    assert condition.after(reference, sums, 10.0) is condition
