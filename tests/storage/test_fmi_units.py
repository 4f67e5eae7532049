"""FMI 2.0 units: FMPy, a simulator of another make, validates and runs them."""

import shutil
import zipfile
from itertools import product

import numpy as np
import pytest

from support.fmi_runner import INPUTS, Running
from valvemap.errors import StorageError
from valvemap.model.flow_map import FlowMap
from valvemap.model.inverse_map import invert
from valvemap.model.lookup_table import lookup_table
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples, Trace
from valvemap.model.support import Support
from valvemap.model.tensor_spline import TensorSpline
from valvemap.model.valve_tables import valve_tables
from valvemap.storage import fmi_units
from valvemap.storage.fmi_units import write_unit
from valvemap.vocabulary.statuses import InverseStatus

pytestmark = pytest.mark.compiler

ESTIMATORS = {
    "eq. (7)": RecursiveLeastSquares(),
    "kinked spline": RecursiveLeastSquares(
        TensorSpline((0, 30, 100), (0, 7, 15), (), 8.0, 91.0, at_rest="zero")
    ),
    "network": RbfNetwork(),
    "auto": FlowMap(),
}
N = 5000
ODD = (np.nan, -np.inf, np.inf, 1e308, -1e308, 5e-324, 0.0, -1.0, 50.0, 100.0, 250.0)


@pytest.fixture(scope="module", params=ESTIMATORS)
def unit(request, tmp_path_factory):
    if not any(map(shutil.which, fmi_units.COMPILERS)):
        pytest.skip("no C compiler here")
    estimator = ESTIMATORS[request.param]
    rng = np.random.default_rng(4)
    U, dp = rng.uniform(0, 100, N), rng.uniform(1, 150, N)
    Q = 2.0 * np.clip(U - 6.0, 0, 90) * np.sqrt(dp / 200) + 0.3 * rng.normal(size=N)
    samples = Samples.of(np.arange(N), U, dp, 0 * dp, Q, np.full(N, 40.0))
    state, _ = estimator.update(estimator.initial_state(), samples)
    support = Support.none().add(samples, Trace(Q, 0 * Q, 0 * Q, np.zeros(N, np.uint8)))
    table = lookup_table(estimator, state, support=support)
    tables = valve_tables(estimator, state, table, support, 0.3)
    file = tmp_path_factory.mktemp("unit") / "valve.fmu"
    assert write_unit(file, tables, f'V1 by "{request.param}" <&>') == "linux64"
    return file, tables, estimator, state, support


@pytest.fixture
def running(unit):
    run = Running(unit[0])
    yield run
    run.close()


def test_fmpy_validates_the_description_and_simulates_the_unit(unit):
    from fmpy import simulate_fmu
    from fmpy.validation import validate_fmu

    file, tables, estimator, state, _ = unit
    assert validate_fmu(str(file)) == []
    t = np.linspace(0.0, 1.0, 11)
    dtype = [("time", float), ("U", float), ("Q_demand", float), ("dp", float)]
    given = np.array([(x, 100 * x, 100 * x, 100.0) for x in t], dtype)
    found = simulate_fmu(
        str(file), stop_time=1.0, output_interval=0.1, input=given, output=["Q", "U_required"]
    )
    expected = estimator.predict(state, 100 * t, np.full(11, 100.0), np.full(11, 40.0))[0]
    assert np.abs(found["Q"][1:] - expected[:-1]).max() <= tables.forward.error  # inputs of a step


def test_the_units_flow_and_required_U_are_within_the_stated_errors(unit, running):
    _, tables, estimator, state, _ = unit
    rng = np.random.default_rng(5)
    n = 20_000
    U, dp = rng.uniform(0, 100, n), rng.uniform(5, 200, n)
    low, high = (
        np.interp(dp, tables.inverse.dp, x) for x in (tables.inverse.lowest, tables.inverse.highest)
    )
    demand = low + rng.uniform(-0.02, 1.02, n) * (high - low)
    found = running.at(U=U, Q_demand=demand, dp=dp)
    T = np.full(n, 40.0)
    assert np.abs(found["Q"] - estimator.predict(state, U, dp, T)[0]).max() <= tables.forward.error
    known = found["U_status"] != InverseStatus.UNIDENTIFIED
    delivered = estimator.predict(state, found["U_required"], dp, T)[0]
    apart = np.abs(delivered - np.clip(demand, low, high))[known]
    assert apart.max() <= tables.inverse.error_Q
    assert (found["U_lower"] <= found["U_required"]).all()
    assert (found["U_required"] <= found["U_upper"]).all()
    assert (found["Q_lower"] <= found["Q"]).all()


@pytest.mark.parametrize("n", [100_000, pytest.param(1_000_000, marks=pytest.mark.soak)])
def test_flows_are_within_the_certified_error(unit, n):
    """The table's own interpolation, which the test above compares with the compiled one."""
    _, tables, estimator, state, _ = unit
    forward, rng = tables.forward, np.random.default_rng(6)
    U, s = rng.uniform(0, 100, n), rng.uniform(0, forward.s[-1], n)
    i, j = (np.clip(np.searchsorted(a, x) - 1, 0, len(a) - 2) for a, x in axes(forward, U, s))
    u = (U - forward.U[i]) / np.diff(forward.U)[i]
    v = (s - forward.s[j]) / np.diff(forward.s)[j]
    Q = forward.Q
    mine = (1 - u) * ((1 - v) * Q[i, j] + v * Q[i, j + 1])
    mine += u * ((1 - v) * Q[i + 1, j] + v * Q[i + 1, j + 1])
    exact = estimator.predict(state, U, s**2, np.full(n, 40.0))[0]
    assert np.abs(mine - exact).max() <= forward.error
    assert forward.certified


def axes(forward, U, s):
    return (forward.U, U), (forward.s, s)


def test_the_interval_and_the_status_are_those_of_the_service(unit, running):
    _, tables, estimator, state, support = unit
    demand, dp = np.linspace(5.0, 90.0, 30), np.full(30, 120.0)
    found = running.at(Q_demand=demand, dp=dp)
    exact = invert(estimator, state, demand, dp, 40.0, support=support)
    np.testing.assert_allclose(found["U_lower"], exact.lower, atol=tables.inverse.error_U + 2.0)
    np.testing.assert_allclose(found["U_upper"], exact.upper, atol=tables.inverse.error_U + 2.0)
    assert np.mean(found["U_status"] == exact.status) > 0.8
    outside = running.at(U=50.0, Q_demand=50.0, dp=[1.0, 250.0])
    assert outside["U_status"].tolist() == [InverseStatus.OUTSIDE] * 2
    assert outside["Q_status"][1] == InverseStatus.OUTSIDE
    beyond = running.at(Q_demand=[1e6, -1e6], dp=100.0)
    assert beyond["U_required"].tolist() == [100.0, 0.0]


def test_no_input_gives_no_number_with_status_0_nor_a_number_that_is_none(running):
    points = np.array(list(product(ODD, ODD, ODD)))
    found = running.at(**dict(zip(INPUTS, points.T, strict=True)))
    for name in ("Q", "Q_lower", "Q_upper", "U_required", "U_lower", "U_upper"):
        assert np.isfinite(found[name]).all(), name
    U_or_dp = ~np.isfinite(points[:, 0]) | ~np.isfinite(points[:, 2])
    assert ((found["Q_status"] == InverseStatus.NOT_FINITE) == U_or_dp).all()
    Q_or_dp = ~np.isfinite(points[:, 1]) | ~np.isfinite(points[:, 2])
    assert ((found["U_status"] == InverseStatus.NOT_FINITE) == Q_or_dp).all()


def test_the_constants_state_the_errors_and_a_state_can_be_kept(unit, running):
    _, tables, *_ = unit
    stated = running.slave.getReal([running.references["error_Q"]])[0]
    assert tables.forward.error <= stated <= 1.001 * tables.forward.error
    slave, reference = running.slave, [running.references["Q_demand"]]
    slave.setReal(reference, [12.0])
    kept = slave.getFMUstate()
    slave.setReal(reference, [99.0])
    slave.setFMUstate(kept)
    assert slave.getReal(reference) == [12.0]
    slave.freeFMUstate(kept)


def test_equal_models_are_equal_units_and_without_a_compiler_the_source_remains(
    unit, tmp_path, monkeypatch
):
    _, tables, *_ = unit
    name = "V1 again"
    for k in (1, 2):
        write_unit(tmp_path / f"{k}.fmu", tables, name)
    parts = [zipfile.ZipFile(tmp_path / f"{k}.fmu").read("modelDescription.xml") for k in (1, 2)]
    assert parts[0] == parts[1]
    monkeypatch.setattr(fmi_units, "COMPILERS", ())
    assert write_unit(tmp_path / "source.fmu", tables, name) is None
    names = zipfile.ZipFile(tmp_path / "source.fmu").namelist()
    assert names == ["modelDescription.xml", "sources/valvemap_valve.c"]
    monkeypatch.setattr(fmi_units, "COMPILERS", ("false",))
    with pytest.raises(StorageError, match="false failed"):
        write_unit(tmp_path / "broken.fmu", tables, name)


def test_the_source_of_a_unit_compiles_without_a_warning(unit, tmp_path):
    import subprocess

    source = zipfile.ZipFile(unit[0]).read("sources/valvemap_valve.c")
    (tmp_path / "v.c").write_bytes(source)
    options = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-fPIC", "-c"]
    subprocess.run(["gcc", *options, tmp_path / "v.c", "-o", tmp_path / "v.o"], check=True)
