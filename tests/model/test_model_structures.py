"""Model structures: what their rows are, what they can represent, what they refuse."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import BSpline

from valvemap.errors import ConfigurationError
from valvemap.model.kernels.polynomial import products
from valvemap.model.model_structures import FiveTerms, Polynomial, StructureWithPrior
from valvemap.model.tensor_spline import TensorSpline

KINKED = TensorSpline((0, 50, 100), (0, 4, 9, 15), T=(20, 60), dead_band=8)
STRUCTURES = {
    "eq. (7)": FiveTerms(),
    "fifth order": Polynomial.of_order(5),
    "with viscosity": Polynomial(terms=("1", "U*s*nu^-1", "|s|*dp", "T*|dp|")),
    "spline": TensorSpline.uniform(6, 4),
    "kinked spline with temperature": KINKED,
    "spline at rest": TensorSpline((0, 50, 100), (0, 5, 15), at_rest="zero"),
}
ANYTHING = st.floats(width=64)


def fit(structure, U, dp, T, Q):
    """Batch least squares with the structure's prior."""
    X, y = structure.regressors(U, dp, T), Q
    if isinstance(structure, StructureWithPrior):
        rows, values = structure.prior()
        X, y = np.concatenate([X, rows]), np.concatenate([y, values])
    return np.linalg.lstsq(X, y, rcond=None)[0]


def points(N, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(0, 100, N), rng.uniform(0, 200, N), rng.uniform(15, 65, N)


@pytest.mark.parametrize("name", STRUCTURES)
@given(data=arrays(float, (3, 7), elements=ANYTHING))
def test_a_row_depends_on_its_own_point_alone_bit_for_bit(name, data):
    structure = STRUCTURES[name]
    together = structure.regressors(*data)
    assert together.shape == (7, len(structure.parameter_names))
    for i in range(7):
        alone = structure.regressors(*np.ascontiguousarray(data[:, i : i + 1]))
        assert alone.tobytes() == together[i : i + 1].tobytes()


@pytest.mark.parametrize("name", STRUCTURES)
def test_names_are_unique_and_as_many_as_the_parameters(name):
    names = STRUCTURES[name].parameter_names
    assert len(set(names)) == len(names)


def test_eq_7_is_one_polynomial_among_many():
    U, dp, T = points(50)
    s = np.sqrt(dp)
    expected = np.stack([np.ones(50), U, s, U * s, dp], axis=1)
    assert np.array_equal(FiveTerms().regressors(U, dp, T), expected)
    assert FiveTerms().parameter_names == ("a1", "a2", "a3", "a4", "a5")


def test_a_flow_that_turns_round_keeps_its_sign():
    row = Polynomial(terms=("s", "|s|", "s*|s|", "dp", "|dp|", "s^2")).regressors(
        np.zeros(1), np.array([-16.0]), np.zeros(1)
    )
    assert row.tolist() == [[-4, 4, -16, -16, 16, 16]]


def test_the_viscosity_is_the_oils_at_its_two_given_temperatures():
    nu = Polynomial(terms=("nu",), viscosity_40=32.0, viscosity_100=5.4)
    rows = nu.regressors(np.zeros(4), np.zeros(4), np.array([40.0, 100.0, np.nan, 1e308]))
    np.testing.assert_allclose(rows[:, 0], [32.0, 5.4, np.nan, np.nan])


def test_a_structure_without_temperature_does_not_ask_for_it():
    U, dp, _ = points(5)
    blind = np.full(5, np.nan)
    assert np.isfinite(FiveTerms().regressors(U, dp, blind)).all()
    assert np.isfinite(STRUCTURES["spline"].regressors(U, dp, blind)).all()
    assert np.isnan(KINKED.regressors(U, dp, blind)).any(axis=1).all()


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ((), "no terms"),
        (("U*x",), "'x' is none of 1, U, s"),
        (("U^1.5",), "none of"),
        (("U", ""), "'' is none of"),
        (("U*s", "s*U"), r"terms U\*s, s\*U are the same"),
    ],
)
def test_a_term_that_cannot_be_read_is_named(terms, message):
    with pytest.raises(ConfigurationError, match=message):
        Polynomial(terms=terms)


def test_as_many_names_as_terms():
    with pytest.raises(ConfigurationError, match="1 names for 2 terms"):
        Polynomial(terms=("1", "U"), names=("a",))


def test_an_oil_that_thickens_with_heat_is_refused():
    with pytest.raises(ConfigurationError, match="viscosity_40 > viscosity_100"):
        Polynomial(terms=("nu",), viscosity_40=5.0, viscosity_100=10.0)


@pytest.mark.parametrize(
    "breaks", [(0.0,), (0.0, 5.0, 3.0), (0.0, 0.0, 3.0), (0.0, math.nan), (0.0, math.inf)]
)
def test_breaks_that_do_not_ascend_are_refused(breaks):
    with pytest.raises(ConfigurationError, match="ascending breaks"):
        TensorSpline(breaks, (0.0, 14.0))


def test_nodes_that_do_not_ascend_are_refused():
    for T in ((40.0,), (60.0, 20.0), (20.0, 20.0)):
        with pytest.raises(ConfigurationError, match="ascending nodes"):
            TensorSpline((0.0, 100.0), (0.0, 14.0), T=T)


@pytest.mark.parametrize(("dead_band", "saturation"), [(0.0, None), (90.0, 10.0), (50.0, None)])
def test_a_kink_outside_or_on_the_breaks_is_refused(dead_band, saturation):
    with pytest.raises(ConfigurationError, match="dead_band < saturation < 100"):
        TensorSpline((0, 50, 100), (0, 14), dead_band=dead_band, saturation=saturation)


def test_beyond_a_kink_the_prior_costs_a_plateau_nothing():
    structure = TensorSpline((0, 50, 100), (0, 14), dead_band=8.0, saturation=95.0)
    sites_U, sites_s = structure.sites
    valve = np.outer(np.clip(sites_U, 8.0, 95.0), sites_s).ravel()
    np.testing.assert_allclose(structure.prior()[0] @ valve, 0.0, atol=1e-9)


def test_the_basis_is_scipys_inside_the_breaks():
    structure = TensorSpline((0, 30, 100), (0, 2, 14), dead_band=8.0, saturation=97.0)
    U, dp, T = points(200)
    s = np.clip(np.sqrt(dp), 0, 14)
    knots_U, knots_s = structure.knots
    in_U = BSpline.design_matrix(U, knots_U, 3).toarray()
    in_s = BSpline.design_matrix(s, knots_s, 3).toarray()
    expected = np.einsum("ni,nj->nij", in_U, in_s).reshape(200, -1)
    np.testing.assert_allclose(structure.regressors(U, s**2, T), expected, atol=1e-12)


def test_outside_its_breaks_the_map_runs_on_along_the_tangent():
    structure = TensorSpline.uniform(4, 3, dp_max=100.0)
    theta = np.random.default_rng(0).normal(size=len(structure.parameter_names))
    s = np.array([9.0, 10.0, 11.0, 12.0, 20.0])
    Q = structure.regressors(np.full(5, 103.0), s**2, s) @ theta
    assert np.ptp(np.diff(Q)[1:] / np.diff(s)[1:]) < 1e-9


def test_cubics_and_eq_7_are_represented_exactly():
    U, dp, T = points(400)
    s = np.sqrt(dp)
    Q = 3 + 0.1 * U - 2e-5 * U**3 * s + 0.3 * s**3
    structure = TensorSpline((0, 30, 100), (0, 6, 15), smoothness=0.0)
    theta = fit(structure, U, dp, T, Q)
    np.testing.assert_allclose(structure.regressors(U, dp, T) @ theta, Q, atol=1e-7)


def test_a_parameter_is_named_after_the_place_where_it_is_the_maps_value():
    structure = TensorSpline.uniform(3, 2)
    sites_U, sites_s = structure.sites
    plane = (sites_U[:, None] + 7 * sites_s[None, :]).ravel()
    U, dp, T = points(50)
    np.testing.assert_allclose(structure.regressors(U, dp, T) @ plane, U + 7 * np.sqrt(dp))


def test_a_dead_band_is_a_kink_and_exact():
    U, dp, T = points(2000)
    Q = np.maximum(U - 8.0, 0.0) * (1 + T / 100)
    theta = fit(replace(KINKED, smoothness=1e-4), U, dp, T, Q)
    assert np.abs(KINKED.regressors(U, dp, T) @ theta - Q).max() < 0.05


def test_at_rest_nothing_flows_whatever_the_parameters():
    structure = STRUCTURES["spline at rest"]
    U, dp, T = points(20)
    assert not structure.regressors(U, 0 * dp, T).any()
    free = TensorSpline(structure.U, structure.s)
    in_common = free.regressors(U, dp, T).reshape(20, 5, 5)[:, :, 1:].reshape(20, -1)
    assert np.array_equal(structure.regressors(U, dp, T), in_common)


def test_cells_without_data_continue_their_neighbours():
    structure = TensorSpline.uniform(6, 4)
    U, dp, T = points(3000)
    seen = (U < 60) | (dp > 100)

    def valve(U, dp):
        return 0.14 * U * np.sqrt(dp)

    rng = np.random.default_rng(1)
    theta = fit(
        structure, U[seen], dp[seen], T[seen], valve(U, dp)[seen] + rng.normal(size=seen.sum())
    )
    error = structure.regressors(U, dp, T) @ theta - valve(U, dp)
    assert np.abs(error[~seen]).max() < 10.0
    assert math.sqrt(np.mean(error[seen] ** 2)) < 0.2


def test_the_prior_costs_a_plane_nothing_and_leaves_the_rest_to_the_data():
    for structure in (STRUCTURES["spline"], KINKED, STRUCTURES["spline at rest"]):
        rows, values = structure.prior()
        assert rows.shape == (len(values), len(structure.parameter_names))
        assert not values.any()
        sites_U, sites_s = structure.sites
        opening = np.maximum(sites_U, structure.dead_band or 0.0)
        plane = np.kron(np.outer(opening, sites_s).ravel(), np.ones(max(1, len(structure.T))))
        np.testing.assert_allclose(rows @ plane, 0.0, atol=1e-9)


def test_powers_of_huge_numbers_are_infinite_without_a_word():
    table, walther = Polynomial(terms=("U^9",))._table, (1.0, 1.0)
    assert products(np.array([1e300]), np.zeros(1), np.zeros(1), table, walther) == np.inf
