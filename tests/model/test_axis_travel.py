"""The position of an axis whose speed is measured: ranges of places, gaps, and the map from it."""

import numpy as np
import pytest

from valvemap.model.axis import AxisGeometry, AxisRegression, AxisSamples
from valvemap.model.axis_basis import COMMON
from valvemap.model.axis_search import fitted, identify
from valvemap.model.axis_travel import Travel, placed
from valvemap.model.kernels.axis_rows import FORCE, ZERO
from valvemap.vocabulary.edges import EDGES
from valvemap.vocabulary.statuses import AxisStatus
from valvemap_rig.directional import DirectionalValve, true_edge_flow
from valvemap_rig.machine import Cylinder, Machine
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import Commands, advance, initial

GEOMETRY = AxisGeometry(63, 45, 800, 1.2, 1.2)
VALVE = DirectionalValve(leakage_l_min_bar=0.0, play_percent=2.0)
SIGMA = 0.4  # l/min


@pytest.fixture(scope="module")
def block():
    machine = Machine(name="Axis", measures="position", valve=VALVE)
    scenario = Scenario(valves=(), machines=(machine,))
    return advance(scenario, initial(scenario, 0), 12_000, Commands())[1].machines["Axis"]


def of_speed(block, v):
    pressures = {name: block.shown[name] for name in ("U", "pA", "pB", "pS", "pT", "T")}
    return AxisSamples.of(block.t, v=v, **pressures)


@pytest.fixture(scope="module")
def samples(block):
    noise = np.random.default_rng(4).standard_normal(len(block.t))
    return of_speed(block, block.truth["v"] + 0.15 + noise)


def test_moves_exclude_places_until_the_position_is_known(block, samples):
    x = Travel.initial().update(samples, 800.0)[1].x
    off = np.abs(x - block.truth["x"])
    unused = 800.0 - np.ptp(block.truth["x"])
    assert x[0] == 400.0
    assert off[3_000:].max() < 0.5 * unused + 30.0


def test_in_a_recording_the_moves_after_a_sample_exclude_places_too(block, samples):
    x = placed(samples, 800.0).x
    forward = Travel.initial().update(samples, 800.0)[1].x
    off = x - block.truth["x"]
    assert np.std(off) < 0.5 * np.std(forward - block.truth["x"])
    assert np.ptp(off) < 60.0  # mm; the first sample's was 400 at any place


def test_any_division_of_the_samples_gives_the_same_places(samples):
    travel, parts = Travel.initial(), []
    whole = travel.update(samples, 800.0)[1].x
    for start, end in ((0, 1), (1, 1), (1, 998), (998, 12_000)):
        travel, part = travel.update(samples[start:end], 800.0)
        parts.append(part.x)
    assert np.concatenate(parts).tobytes() == whole.tobytes()


def test_after_a_gap_every_place_is_possible_and_without_speed_there_is_none(samples):
    v = samples.v.copy()
    v[5_000:5_010], v[6_000:6_200] = np.nan, np.nan
    x = Travel.initial().update(AxisSamples.of(samples.t, v=v), 800.0)[1].x
    assert np.array_equal(np.isnan(x), np.isnan(v))
    assert abs(x[5_010] - x[4_999]) < 20.0
    assert x[6_200] == 400.0


def test_a_measured_position_stays_as_it_is(block):
    both = AxisSamples.of(block.t, x=block.shown["x"], v=block.truth["v"])
    assert placed(both, 800.0) is both


def test_speed_and_pressures_give_the_rigs_edges(samples):
    known = AxisRegression(GEOMETRY, play_percent=2.0, spool_hz=40.0)
    _, found = fitted(known, placed(samples, GEOMETRY.stroke_mm))
    U, dp = np.meshgrid(np.arange(12.0, 48.0, 6.0), [40.0, 80.0])
    off = [found.flow(edge, U, dp) - true_edge_flow(VALVE, edge, U, dp) for edge in EDGES]
    assert float(np.sqrt(np.mean(np.square(off)))) / SIGMA < 0.6
    zero = COMMON + ZERO
    std = float(np.sqrt(found.covariance[zero, zero]))
    assert 0.0 < std < 0.15  # mm/s; of the zero of the speed, 0.2 without samples
    assert abs(found.theta[zero] - 0.15) < 3.0 * std
    assert found.bulk_modulus[0] == pytest.approx(0.9, rel=0.1)
    assert found.leakage[0] == pytest.approx(0.002, rel=0.3)


def test_a_recording_of_speed_is_identified_and_one_without_either_is_refused(samples):
    assert identify(samples, GEOMETRY, searched=False).status is AxisStatus.OK
    given = {name: getattr(samples, name) for name in ("U", "pA", "pB", "pS", "pT")}
    neither = identify(AxisSamples.of(samples.t, **given), GEOMETRY)
    assert neither.status is AxisStatus.MISSING_SIGNAL


@pytest.fixture(scope="module")
def light_block():
    """A light piston, which a load that changes at the samples makes swing between them."""
    cylinder = Cylinder(mass_kg=300.0, bulk_modulus_GPa=1.4)
    machine = Machine(name="Axis", measures="position", valve=VALVE, cylinder=cylinder)
    scenario = Scenario(valves=(), machines=(machine,), seed=3)
    return advance(scenario, initial(scenario, 0), 12_000, Commands())[1].machines["Axis"]


def test_the_mean_speed_between_samples_is_found_from_the_force(light_block):
    known = AxisRegression(GEOMETRY, play_percent=2.0, spool_hz=40.0, has_place=False)
    samples = of_speed(light_block, light_block.truth["v"])
    _, found = fitted(known, placed(samples, GEOMETRY.stroke_mm))
    force = COMMON + FORCE
    std = float(np.sqrt(found.covariance[force, force]))
    assert found.theta[force] == pytest.approx(1.0 / 0.3, rel=0.3)  # 1/t
    assert 0.0 < std < 0.5
    c, of_c = found.leakage
    assert abs(c - 0.002) < 2.5 * of_c
