"""What moves at an axis' edges: sudden changes are followed within a minute, noise is not."""

from dataclasses import replace

import numpy as np
import pytest

from valvemap.model.axis import AxisGeometry, AxisRegression, AxisSamples
from valvemap.model.axis_basis import SIZE, columns
from valvemap.model.axis_fit import fit, moved, with_map, with_moved_sums
from valvemap.model.axis_search import fitted
from valvemap.model.kernels.flow_drift import EDGE, GAIN
from valvemap.vocabulary.edges import EDGES
from valvemap_rig.directional import DirectionalValve, true_edge_flow
from valvemap_rig.faults import Fault, FaultKind
from valvemap_rig.machine import Machine
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import Commands, advance, initial

SIGNALS = ("U", "x", "pA", "pB", "pS", "pT", "T")
VALVE = DirectionalValve(leakage_l_min_bar=0.0, play_percent=2.0)
KNOWN = AxisRegression(
    AxisGeometry(63, 45, 800, 1.2, 1.2),
    play_percent=2.0,
    spool_hz=40.0,
    changes_per_s=1.0 / 360_000.0,
)
HEALTHY, AFTER = 22_000, 6_000  # samples


def scenario(valve):
    machine = Machine(name="Axis", measures="position", valve=valve)
    return Scenario(valves=(), machines=(machine,))


def as_samples(block):
    shown = block.machines["Axis"].shown
    return AxisSamples.of(block.t, **{name: shown[name] for name in SIGNALS})


@pytest.fixture(scope="module")
def healthy():
    """The rig after healthy work, its samples, and the state that has learnt from them."""
    rig, block = advance(scenario(VALVE), initial(scenario(VALVE), 0), HEALTHY)
    samples = as_samples(block)
    state, found = fitted(replace(KNOWN, changes_per_s=0.0), samples[:7_000])
    state, _ = KNOWN.update(with_map(state, found), samples[7_000:])
    return rig, samples, with_map(state, fit(KNOWN, state))


def continued(healthy, valve, faults=()):
    rig, _, state = healthy
    damage = tuple(
        ("Axis", Fault(kind=FaultKind.DAMAGE, start_s=0, size=size, edge=edge))
        for edge, size in faults
    )
    _, block = advance(scenario(valve), rig, AFTER, Commands(faults=damage))
    after, _ = KNOWN.update(state, as_samples(block))
    return after


def gains(state):
    return state.drift_now[:, 0, GAIN]


@pytest.mark.parametrize("pair", [("PA", "BT"), ("PA", "AT")])
def test_two_edges_that_pass_thirty_percent_less_are_followed_within_a_minute(healthy, pair):
    after = continued(healthy, VALVE, [(edge, -30.0) for edge in pair])
    expected = [-0.3 if edge in pair else 0.0 for edge in EDGES]
    assert gains(after) == pytest.approx(expected, abs=0.02)
    found = moved(fit(KNOWN, after), after)
    U = np.arange(30.0, 61.0, 10.0)
    for edge, gain in zip(EDGES, expected, strict=True):
        truth = (1.0 + gain) * true_edge_flow(VALVE, edge, U, 70.0)
        assert found.flow(edge, U, 70.0) == pytest.approx(truth, rel=0.04), edge
        off = np.abs(found.flow(edge, U, 70.0) - truth)
        assert (off <= 4.0 * found.flow_std(edge, U, 70.0)).all(), edge


def test_an_edge_that_opens_later_is_a_shift(healthy):
    later = VALVE.PA.model_copy(update={"overlap_percent": VALVE.PA.overlap_percent + 3.0})
    after = continued(healthy, VALVE.model_copy(update={"PA": later}))
    assert after.drift_now[0, 0, EDGE] == pytest.approx(3.26, abs=0.4)  # 3 % of overlap, at U = 0
    assert np.abs(after.drift_now[1:, 0, EDGE]).max() < 0.3


def test_healthy_work_moves_nothing(healthy):
    after = continued(healthy, VALVE)
    assert np.abs(gains(after)).max() < 0.01
    assert np.abs(after.drift_now[:, 0, EDGE]).max() < 0.2
    assert not after.has_changed


def test_any_division_gives_the_same_bits(healthy):
    _, samples, state = healthy
    part = samples[7_000:9_000]
    whole, _ = KNOWN.update(state, part)
    cut = state
    for start, end in ((0, 1), (1, 700), (700, 2_000)):
        cut, _ = KNOWN.update(cut, part[start:end])
    for name, array in vars(whole).items():
        assert array.tobytes() == getattr(cut, name).tobytes(), name


def test_without_changes_expected_none_is_followed(healthy):
    _, samples, state = healthy
    plain = replace(KNOWN, changes_per_s=0.0)
    after, _ = plain.update(state, samples[7_000:8_000])
    for name in ("drift_x", "drift_now", "stay", "stay_noise"):
        assert getattr(after, name).tobytes() == getattr(state, name).tobytes(), name


def test_moved_sums_have_the_moved_edges_as_their_fit(healthy):
    after = continued(healthy, VALVE, [("PA", -30.0)])
    found, of_sums = moved(fit(KNOWN, after), after), fit(KNOWN, with_moved_sums(after))
    for edge in EDGES:
        U = np.arange(20.0, 61.0, 10.0)
        assert of_sums.flow(edge, U, 70.0) == pytest.approx(found.flow(edge, U, 70.0), rel=0.01)
    own = columns("PA")
    assert found.theta[own] == pytest.approx(0.7 * fit(KNOWN, after).theta[own], rel=0.05, abs=0.02)
    assert len(found.theta) == SIZE
