"""The valve as a hydraulics engineer would check it: limit cases by hand, then the curves."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valvemap_rig.kernels import RHO_K
from valvemap_rig.oil import Oil, density
from valvemap_rig.valvistor import Valvistor, pilot_opening, poppet_state

OIL = Oil()
VALVE = Valvistor()
IDEAL = Valvistor(
    jet_angle_deg=90,
    spring_preload_N=0,
    spring_rate_N_mm=0,
    pilot_jet_per_bar=0,
    poppet_transition_re=0,
    slot_transition_re=0,
    pilot_leakage_l_min_bar=0,
    seat_leakage_l_min_bar=0,
    stroke_mm=10,
)


def settled(valve, y, dp, p1=200.0, T=40.0):
    y, dp, p1, T = np.broadcast_arrays(*(np.asarray(a, dtype=float) for a in (y, dp, p1, T)))
    return poppet_state(valve, OIL, y, p1, p1 - dp, T, np.ones(y.shape))


def lighter(p1=200.0, T=40.0):
    """√(ρ_K/ρ): what the oil's density does to every flow coefficient."""
    return math.sqrt(RHO_K / density(OIL, np.array([p1]), np.array([T]))[0])


# --- the ideal Valvistor, by hand -------------------------------------------------------------


@pytest.mark.parametrize("phi", [1.5, 2.0, 3.0])
def test_the_ideal_poppet_stands_where_the_corrected_equation_3_says(phi):
    valve = IDEAL.model_copy(update={"phi": phi})
    y = np.array([0.2, 0.5, 1.0])
    x_PV = valve.pilot_stroke_mm * y

    state = settled(valve, y, 90.0)

    expected = valve.K_PV * x_PV / (valve.K_c * math.sqrt(phi - 1)) - valve.x_0_mm
    assert state.x_MP == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("phi", [1.5, 3.0])
def test_equation_3_as_printed_fails_where_the_corrected_one_holds(phi):
    valve, dp = IDEAL.model_copy(update={"phi": phi, "x_0_mm": 0.0}), 90.0
    state = settled(valve, [0.5], dp, p1=1e-3 + dp)
    Q_PV = state.Q_PV / lighter(1e-3 + dp)

    printed = Q_PV / valve.K_c * math.sqrt((phi - 1) / (phi * dp))
    corrected = Q_PV / valve.K_c * math.sqrt(phi / ((phi - 1) * dp))

    assert state.x_MP == pytest.approx(corrected, rel=1e-9)
    assert corrected / printed == pytest.approx(phi / (phi - 1))


def test_the_ideal_valve_amplifies_the_pilot_flow_as_equation_5_corrected():
    valve = IDEAL.model_copy(update={"x_0_mm": 0.0, "phi": 3.0})
    state = settled(valve, [0.3, 0.6], [50.0, 120.0])
    gain = valve.K_MP / valve.K_c * math.sqrt(3.0 / 2.0)
    assert pytest.approx(gain, rel=1e-9) == (state.Q - state.Q_PV) / state.Q_PV


def test_keeping_the_overlap_takes_its_share_of_root_dp_off_the_main_flow():
    without, dp = IDEAL.model_copy(update={"x_0_mm": 0.0}), 80.0
    lost = settled(without, [0.5], dp).Q - settled(IDEAL, [0.5], dp).Q
    assert lost == pytest.approx(IDEAL.K_MP * IDEAL.x_0_mm * math.sqrt(dp) * lighter(), rel=1e-9)


def test_the_ideal_valve_has_only_a3_and_a4_of_equation_7():
    U, dp = (a.ravel() for a in np.meshgrid(np.linspace(20, 95, 16), np.linspace(5, 190, 20)))
    Q = settled(IDEAL, pilot_opening(IDEAL, U), dp).Q
    s = np.sqrt(dp)

    rows = np.stack([np.ones_like(U), U, s, U * s, dp], axis=1)
    theta, *_ = np.linalg.lstsq(rows, Q, rcond=None)

    assert rows @ theta == pytest.approx(Q, rel=1e-9)
    assert theta[[0, 1, 4]] == pytest.approx(np.zeros(3), abs=1e-9)


def test_a_jet_force_alone_leaves_the_flow_proportional_to_root_dp():
    valve = IDEAL.model_copy(update={"jet_angle_deg": 45.0})
    dp = np.array([1.0, 10.0, 50.0, 190.0])
    ratio = settled(valve, np.full(4, 0.7), dp).Q / np.sqrt(dp)
    assert ratio == pytest.approx(np.full(4, ratio[0]), rel=1e-9)
    assert ratio[0] < 0.97 * (settled(IDEAL, [0.7], 1.0).Q[0])


@pytest.mark.parametrize(
    "change",
    [
        {"spring_preload_N": 20.0},
        {"spring_rate_N_mm": 5.0},
        {"pilot_jet_per_bar": 6e-4},
        {"poppet_transition_re": 30.0},
        {"slot_transition_re": 15.0},
    ],
)
def test_each_force_that_does_not_scale_with_dp_bends_the_curve(change):
    dp = np.array([10.0, 190.0])
    ratio = settled(IDEAL.model_copy(update=change), np.full(2, 0.7), dp).Q / np.sqrt(dp)
    assert abs(ratio[1] / ratio[0] - 1) > 1e-3


def test_on_its_seat_pilot_and_slot_are_in_series():
    dp, y = 100.0, 0.5 * IDEAL.K_c * IDEAL.x_0_mm / (IDEAL.K_PV * IDEAL.pilot_stroke_mm)
    slot, pilot = IDEAL.K_c * IDEAL.x_0_mm, IDEAL.K_PV * IDEAL.pilot_stroke_mm * y

    state = settled(IDEAL, [y], dp)

    assert state.x_MP[0] == 0.0
    in_series = math.sqrt(dp / (1 / slot**2 + 1 / pilot**2)) * lighter()
    assert state.Q[0] == pytest.approx(in_series, rel=1e-9)
    assert state.p_c[0] > 200 - dp / 2  # above the balance (1): the seat carries the rest


def test_at_its_stop_the_poppet_passes_what_an_orifice_of_that_opening_does():
    valve = IDEAL.model_copy(update={"stroke_mm": 1.0})
    state = settled(valve, [1.0], 100.0)
    assert state.x_MP[0] == 1.0
    assert (state.Q - state.Q_PV)[0] == pytest.approx(valve.K_MP * 10 * lighter(), rel=1e-9)
    assert state.p_c[0] < 200 - 50.0


# --- the balance itself -----------------------------------------------------------------------


def test_where_the_poppet_floats_forces_and_flows_are_in_balance():
    y, dp = (a.ravel() for a in np.meshgrid(np.linspace(0.1, 0.95, 9), np.linspace(5, 190, 9)))
    valve, p2 = VALVE, 200.0 - dp
    state = settled(valve, y, dp)
    rho = density(OIL, np.full(dp.shape, 200.0), np.full(dp.shape, 40.0))

    def orifice(K, D_h, re_t, drop):
        """C_d(Re) = C_d∞/√(1 + Re_t/Re), iterated until Re and flow agree."""
        C_inf, Re = valve.discharge_coefficient, np.full(drop.shape, 1e6)
        for _ in range(200):
            C_d = C_inf / np.sqrt(1 + re_t / Re)
            Re = 1e3 * C_d * D_h * np.sqrt(2e5 * drop / rho) / 46.0
        return K * C_d / C_inf * np.sqrt(drop * RHO_K / rho)

    def slot(K, opening, drop):
        width = K / (0.06 * valve.discharge_coefficient * math.sqrt(2e5 / RHO_K))
        D_h = 4 * width * opening / (2 * (width + opening))
        return orifice(K * opening, D_h, valve.slot_transition_re, drop)

    x = state.x_MP
    assert ((x > 0) & (x < valve.stroke_mm)).all()
    Q_MP = orifice(valve.K_MP * x, 2 * x * math.sqrt(0.5), valve.poppet_transition_re, dp)
    Q_c = slot(valve.K_c, valve.x_0_mm + x, 200.0 - state.p_c)
    assert Q_c == pytest.approx(state.Q_PV, rel=1e-7)  # eq. (2)

    A = valve.poppet_area_mm2
    jet = math.cos(math.radians(45)) * Q_MP / 6e4 * np.sqrt(2 * rho * dp * 1e5)
    spring = valve.spring_preload_N + valve.spring_rate_N_mm * x
    opening_force = 0.1 * (A / valve.phi * 200.0 + (A - A / valve.phi) * p2)
    assert opening_force == pytest.approx(0.1 * A * state.p_c + spring + jet, rel=1e-9)  # eq. (1)
    seat = valve.seat_leakage_l_min_bar * dp
    assert pytest.approx(Q_MP + state.Q_PV + seat, rel=2e-3) == state.Q  # eq. (6)


# --- the curves -------------------------------------------------------------------------------


def test_flow_rises_with_the_signal_and_never_falls():
    U = np.linspace(0, 100, 2001)
    for dp in (0.1, 1, 10, 50, 100, 200):
        Q = settled(VALVE, pilot_opening(VALVE, U), dp).Q
        assert (np.diff(Q) >= -1e-9).all()
        rising = (U[:-1] > VALVE.dead_band_percent) & (U[1:] < VALVE.saturation_percent)
        assert (np.diff(Q)[rising] > 0).all()


def test_flow_rises_with_pressure_drop():
    dp = np.linspace(0, 200, 2001)
    for y in (0, 0.01, 0.05, 0.2, 0.6, 1):
        assert (np.diff(settled(VALVE, np.full(dp.shape, y), dp).Q) > 0).all()


def test_an_open_valve_follows_the_root_of_the_pressure_drop():
    dp = np.linspace(20, 200, 50)
    for y in (0.3, 0.6, 1.0):
        exponent = np.gradient(np.log(settled(VALVE, np.full(50, y), dp).Q), np.log(dp))
        assert (exponent > 0.42).all()
        assert (exponent < 0.60).all()


def test_full_signal_passes_about_200_l_min_at_80_bar():
    assert 190 < settled(VALVE, [1.0], 80.0).Q[0] < 230


def test_a_closed_valve_passes_nothing_but_leakage():
    leakage = settled(VALVE, [0.0], 200.0)
    assert leakage.x_MP[0] == 0
    assert 0.05 < leakage.Q[0] < 0.5


def test_leakage_is_laminar_hot_oil_leaks_more():
    cold, hot = settled(VALVE, np.zeros(2), 50.0, T=np.array([40.0, 60.0])).Q
    assert 1.8 < hot / cold < 2.6
    low, high = settled(VALVE, np.zeros(2), np.array([1.0, 2.0])).Q
    assert high / low == pytest.approx(2, rel=0.01)


def test_at_a_trace_of_pressure_drop_an_open_valve_is_laminar():
    valve = VALVE.model_copy(update={"spring_preload_N": 0.0, "spring_rate_N_mm": 0.0})
    low, high = settled(valve, np.full(2, 0.5), np.array([1e-6, 2e-6])).Q
    assert high / low == pytest.approx(2, rel=0.05)


def test_warm_oil_flows_a_little_better_through_an_open_valve():
    cold, hot = settled(VALVE, np.full(2, 0.5), 20.0, T=np.array([20.0, 60.0])).Q
    assert 1.01 < hot / cold < 1.15


def test_leaving_the_seat_makes_no_step():
    y = np.linspace(0, 0.1, 20_001)
    state = settled(VALVE, y, 100.0)
    assert state.x_MP[0] == 0 < state.x_MP[-1]
    assert np.diff(state.Q).max() < 2e-3
    assert np.abs(np.diff(state.p_c)).max() < 0.5


def test_the_pilot_takes_a_few_percent_of_the_flow():
    state = settled(VALVE, [0.6], 100.0)
    assert 0.02 < state.Q_PV[0] / state.Q[0] < 0.10


def test_no_pressure_drop_no_flow_and_none_backwards():
    state = settled(VALVE, [0.5, 0.5], [0.0, -20.0])
    assert state.Q.tolist() == [0.0, 0.0]


def test_a_worn_edge_passes_more():
    one = np.ones(1)
    new = poppet_state(VALVE, OIL, 0.5 * one, 200 * one, 100 * one, 40 * one, one).Q
    worn = poppet_state(VALVE, OIL, 0.5 * one, 200 * one, 100 * one, 40 * one, 1.1 * one).Q
    assert worn / new == pytest.approx(1.09, abs=0.01)


@settings(max_examples=200, deadline=None)
@given(
    phi=st.floats(1.06, 10),
    K_c=st.floats(1e-3, 10),
    K_PV=st.floats(1e-3, 20),
    x_0_mm=st.floats(0, 2),
    stroke_mm=st.floats(0.01, 50),
    poppet_area_mm2=st.floats(1.5, 1e5),
    spring_preload_N=st.floats(0, 1e4),
    jet_angle_deg=st.floats(0, 90),
    pilot_jet_per_bar=st.floats(0, 2e-3),
    poppet_transition_re=st.sampled_from([0.0, 30.0, 5000.0]),
    dp=st.floats(1e-9, 400),
    T=st.floats(-20, 120),
)
def test_any_valve_that_can_be_configured_has_one_steady_state_that_rises_with_the_signal(
    dp, T, **parameters
):
    valve = Valvistor(**parameters)
    state = settled(valve, np.linspace(0, 1, 51), dp, p1=400.0, T=T)
    assert np.isfinite(state.Q).all()
    assert (np.diff(state.Q) >= -1e-7 * (1 + state.Q[:-1])).all()
    assert ((state.x_MP >= 0) & (state.x_MP <= valve.stroke_mm)).all()
    assert ((state.p_c >= 400 - dp - 1e-9) & (state.p_c <= 400 + 1e-9)).all()
