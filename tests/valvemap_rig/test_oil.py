import numpy as np
import pytest

from valvemap_rig.oil import Oil, density, throttling_heat, viscosity


def test_vg_46_has_46_mm2_s_at_40_degrees():
    assert viscosity(Oil(), np.array([40.0]))[0] == pytest.approx(46.0, rel=1e-12)


def test_viscosity_between_the_two_points_is_that_of_a_mineral_oil_of_index_100():
    # ISO 3448, table for viscosity index 95: VG 46 has about 29.7 mm²/s at 50 °C, 135 at 20 °C.
    nu = viscosity(Oil(), np.array([50.0, 20.0]))
    assert nu == pytest.approx([29.7, 135.0], rel=0.03)


def test_a_line_in_walthers_chart_is_straight():
    T = np.linspace(-10, 100, 12)
    lg_lg = np.log10(np.log10(viscosity(Oil(), T) + 0.7))
    slopes = np.diff(lg_lg) / np.diff(np.log10(T + 273.15))
    assert slopes == pytest.approx(np.full(11, slopes[0]), rel=1e-9)


def test_oil_shrinks_by_about_half_a_percent_per_100_bar():
    rho = density(Oil(), np.array([0.0, 100.0]), np.array([40.0, 40.0]))
    assert 0.004 < rho[1] / rho[0] - 1 < 0.008


def test_oil_expands_by_07_percent_per_10_K():
    rho = density(Oil(), np.zeros(2), np.array([15.0, 25.0]))
    assert rho == pytest.approx([875.0, 875.0 * 0.993])


def test_throttling_100_bar_warms_by_about_6_K():
    rho = density(Oil(), np.array([200.0]), np.array([40.0]))
    assert throttling_heat(Oil(), np.array([100.0]), rho)[0] == pytest.approx(6.0, abs=0.2)


def test_all_lost_power_becomes_heat():
    dp_Pa, Q_m3_s, rho = 150e5, 100 / 60_000, 865.0
    rise = throttling_heat(Oil(), np.array([150.0]), np.array([rho]))[0]
    assert rho * Q_m3_s * Oil().heat_capacity_J_kg_K * rise == pytest.approx(dp_Pa * Q_m3_s)
