import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from valvemap_rig import kernels, oil, valvistor
from valvemap_rig.circuit import (
    Bench,
    Circuit,
    largest_drop,
    numbers,
    operating_point,
    reachable,
    tank_temperature,
    true_flow,
)
from valvemap_rig.oil import density
from valvemap_rig.records import Setting
from valvemap_rig.valvistor import pilot_opening, poppet_state

BENCH = Bench()
CIRCUIT = BENCH.circuit


def settled(U, p2_set, bench=BENCH, T=40.0, edge=1.0):
    U, p2_set = np.broadcast_arrays(np.asarray(U, float), np.asarray(p2_set, float))
    y = pilot_opening(bench.valve, U)
    ones = np.ones(U.shape)
    return operating_point(bench, y, p2_set, T * ones, edge * ones)


def test_supply_gives_its_set_pressure_while_nothing_is_taken():
    point = settled([0.0], [200.0])
    assert point.p1[0] == 200.0
    assert point.Q[0] == 0.0


def test_the_valve_passes_what_its_own_map_says_while_the_pump_can_deliver():
    U, p2 = np.array([20.0, 50.0, 80.0]), np.array([20.0, 100.0, 160.0])
    point = settled(U, p2)
    assert pytest.approx(true_flow(BENCH, U, point.dp), rel=3e-4) == point.Q
    assert (point.p1 > CIRCUIT.p0_bar - CIRCUIT.relief_override_bar).all()


def test_beyond_the_pumps_limit_p1_falls_and_the_flow_stays():
    point = settled([100.0, 100.0, 100.0], [100.0, 50.0, 0.0])
    assert (np.diff(point.p1) < -20).all()
    assert point.p1[0] < 180
    assert pytest.approx(np.full(3, 200.0), rel=0.005) == point.Q
    assert point.dp == pytest.approx(np.full(3, point.dp[0]), rel=0.01)


def test_at_the_limit_the_valve_passes_the_mass_that_the_pump_takes_from_the_tank():
    point = settled([100.0], [30.0])
    at_meter = point.Q * density(BENCH.oil, point.p2, point.T2)
    at_pump = CIRCUIT.Q_pump_l_min * density(BENCH.oil, np.zeros(1), point.T1)
    assert at_meter == pytest.approx(at_pump, rel=1e-9)


def test_the_load_valve_holds_its_set_point_but_not_below_its_own_pressure():
    point = settled([30.0, 30.0, 0.0, 100.0], [80.0, 0.0, 0.0, 0.0])
    lowest = CIRCUIT.load_minimum_bar
    assert point.p2[0] == 80.0
    assert lowest < point.p2[1] < lowest + CIRCUIT.load_resistance_bar
    assert point.p2[2] == pytest.approx(lowest, abs=1e-3)
    assert point.p2[3] == pytest.approx(lowest + CIRCUIT.load_resistance_bar)


def test_a_load_above_the_supply_stops_the_flow_and_never_turns_it():
    point = settled([50.0], [250.0])
    assert point.Q[0] == 0.0
    assert point.dp[0] == 0.0


def test_the_oil_leaves_the_valve_6_K_warmer_per_100_bar():
    point = settled([40.0], [97.0])
    assert point.T1[0] == 40.0
    assert (point.T2 - point.T1)[0] == pytest.approx(6.0, abs=0.3)


def test_the_meter_behind_the_valve_counts_warm_oil_without_pressure():
    point = settled([40.0], [0.0])
    one = np.ones(1)
    y = pilot_opening(BENCH.valve, 40 * one)
    at_inlet = poppet_state(BENCH.valve, BENCH.oil, y, point.p1, point.p2, 40 * one, one).Q
    assert 1.01 < point.Q[0] / at_inlet[0] < 1.03


def test_flow_and_pressure_drop_rise_as_the_load_falls():
    p2 = np.linspace(200, 0, 401)
    for U in (5, 10, 40, 70, 100):
        point = settled(U, p2)
        assert (np.diff(point.dp) >= -0.02).all()  # density: dp gives way a little at the limit
        assert (np.diff(point.Q) >= -0.5).all()


def test_what_is_reachable_is_what_the_bench_drives():
    rng = np.random.default_rng(1)
    point = settled(U := rng.uniform(0, 100, 500), rng.uniform(0, 200, 500))
    assert reachable(BENCH, U, point.dp * (1 - 1e-2)).all()
    top = largest_drop(BENCH, U)
    assert reachable(BENCH, U, top).all()
    assert not reachable(BENCH, U, top + 1e-6).any()


def test_nothing_is_reachable_outside_the_signals_range_or_backwards():
    assert not reachable(BENCH, [-1.0, 101.0, 50.0], [10.0, 10.0, -1.0]).any()


def test_a_stronger_pump_reaches_further():
    strong = Bench(circuit=Circuit(Q_pump_l_min=400))
    assert largest_drop(strong, 100.0) > largest_drop(BENCH, 100.0) + 50


def test_the_reachable_region_shrinks_with_the_signal_to_about_60_to_120_bar():
    drop = largest_drop(BENCH, np.linspace(0, 100, 51))
    assert (np.diff(drop) <= 1e-6).all()
    assert drop[0] > 190
    assert 55 < drop[-1] < 120


def test_the_true_map_broadcasts_and_is_zero_without_drop():
    Q = true_flow(BENCH, np.linspace(0, 100, 5)[:, None], [0.0, 50.0])
    assert Q.shape == (5, 2)
    assert (Q[:, 0] == 0).all()


def test_equation_7_misses_the_map_by_a_few_l_min():
    rng = np.random.default_rng(2)
    U, dp = rng.uniform(0, 100, 4000), rng.uniform(0, 200, 4000)
    inside = reachable(BENCH, U, dp)
    U, dp = U[inside], dp[inside]
    Q, s = true_flow(BENCH, U, dp), np.sqrt(dp)
    rows = np.stack([np.ones_like(U), U, s, U * s, dp], axis=1)
    theta, *_ = np.linalg.lstsq(rows, Q, rcond=None)
    rmse = np.sqrt(np.mean((Q - rows @ theta) ** 2))
    assert 4 * 0.4 < rmse < 12 * 0.4


def test_the_tank_drifts_slowly_about_40_degrees():
    T = tank_temperature(CIRCUIT, np.linspace(0, 900, 901))
    assert T[0] == 40.0
    assert (T.min(), T.max()) == pytest.approx((39.0, 41.0), abs=1e-3)
    assert np.abs(np.diff(T)).max() < 0.01  # K/s


@settings(max_examples=60, deadline=None)
@given(
    U=st.floats(0, 100),
    p2_set=st.floats(-50, 400),
    T=st.floats(-20, 120),
    edge=st.floats(0.01, 10),
    p0=st.floats(10, 400),
    pump=st.floats(1, 2000),
    override=st.floats(0.01, 100),
)
def test_every_bench_settles_somewhere_sensible(U, p2_set, T, edge, p0, pump, override):
    circuit = Circuit(p0_bar=p0, Q_pump_l_min=pump, relief_override_bar=override)
    point = settled(U, [p2_set], Bench(circuit=circuit), T=T, edge=edge)
    assert 0 <= point.p2[0] <= point.p1[0] <= p0
    assert 0 <= point.Q[0] <= 1.03 * pump


def test_the_supply_pressure_is_the_root_that_scipy_finds():
    rng = np.random.default_rng(5)
    n = 200
    y, T, edge = rng.uniform(0, 1, n), rng.uniform(20, 80, n), rng.uniform(0.5, 1.1, n)
    columns = (y, rng.uniform(0, 200, n), T, edge, rng.choice([0.0, 1.0], n))
    of_bench = (valvistor.numbers(BENCH.valve), oil.numbers(BENCH.oil), numbers(CIRCUIT))
    p1, p2 = kernels.settled(*of_bench, Setting(*columns))
    shut = CIRCUIT.p0_bar - CIRCUIT.relief_override_bar
    roots = []
    for point in zip(*(column.tolist() for column in columns), strict=True):
        args = (*of_bench, Setting(*point))
        low, high = (0.0, shut) if kernels.excess(shut, *args) > 0 else (shut, CIRCUIT.p0_bar)
        roots.append(brentq(kernels.excess, low, high, args=args, xtol=kernels.ROOT_BAR))
    np.testing.assert_allclose(p1, roots, rtol=0.0, atol=2 * kernels.ROOT_BAR)
    assert 20 < (p1 < shut).sum() < 180  # of both kinds
    assert (p2 <= p1).all()
