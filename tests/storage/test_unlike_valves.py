"""Exports of unlike valves hold what they state: an FMI unit run by FMPy, and Structured Text."""

import shutil

import numpy as np
import pytest

from support.fmi_runner import Running
from support.structured_text import FunctionBlock
from valvemap.model.flow_map import FlowMap
from valvemap.model.inverse_map import invert
from valvemap.model.lookup_table import lookup_table
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.model.support import Support
from valvemap.model.valve_tables import valve_tables
from valvemap.storage import fmi_units
from valvemap.storage.fmi_units import write_unit
from valvemap.storage.structured_text import as_structured_text
from valvemap.vocabulary.statuses import InverseStatus

pytestmark = [pytest.mark.compiler, pytest.mark.timeout(1200)]  # a million points

N, POINTS, T = 4_000, 1_000_000, 45.0
OF_TABLE = 300  # points at which the Structured Text is interpreted


def overlapped(U, dp, oil):
    """A dead band of 20 %, and 0.6 % more flow per °C."""
    return 1.4 * np.clip(U - 20.0, 0, None) * np.sqrt(dp / 100) * (1 + 0.006 * (oil - T))


def saturating(U, dp, oil):
    return 90.0 * np.tanh(U / 45.0) * np.sqrt(dp / 100) + 0.0 * oil


def mirrored(U, dp, oil):
    """The other direction of a valve of both, learnt with -U and -Q as the docs say."""
    recorded = -U
    Q = (0.4 * recorded - 0.004 * recorded**2) * np.sqrt(dp / 100) + 0.0 * oil
    return -Q


VALVES = {
    "Auto, dead band and temperature": (FlowMap(), overlapped),
    "RBF, saturating": (RbfNetwork(), saturating),
    "RLS, the other direction": (RecursiveLeastSquares(), mirrored),
    "RLS, saturating": (RecursiveLeastSquares(), saturating),
    "Auto, saturating": (FlowMap(), saturating),
    "RBF, dead band and temperature": (RbfNetwork(), overlapped),
}
DELIVERED = (InverseStatus.OK, InverseStatus.UNCERTAIN)  # U is the exact inverse of the map
QUICK = {"RLS, the other direction"}


def learnt(estimator, flow):
    rng = np.random.default_rng(8)
    U, dp, oil = rng.uniform(0, 100, N), rng.uniform(1, 200, N), np.linspace(30.0, 60.0, N)
    Q = flow(U, dp, oil) + 0.2 * rng.normal(size=N)
    samples = Samples.of(np.arange(N), U, dp, 0 * dp, Q, oil)
    return estimator.update(estimator.initial_state(), samples)[0]


@pytest.mark.parametrize(
    ("name", "n"),
    [(name, 2_000) for name in QUICK]
    + [pytest.param(name, POINTS, marks=pytest.mark.soak) for name in VALVES],
)
def test_unit_and_structured_text_are_within_the_certified_errors(name, n, tmp_path):
    from fmpy.validation import validate_fmu

    if not any(map(shutil.which, fmi_units.COMPILERS)):
        pytest.skip("no C compiler here")
    estimator, flow = VALVES[name]
    state = learnt(estimator, flow)
    points = (41, 31) if n == POINTS else (13, 9)
    table = lookup_table(estimator, state, T=T, points=points)
    tables = valve_tables(estimator, state, table, Support.none(), 0.2)
    assert table.certified
    assert tables.forward.certified
    file = tmp_path / "valve.fmu"
    write_unit(file, tables, "V")
    assert validate_fmu(str(file)) == []

    rng = np.random.default_rng(9)
    U, dp = rng.uniform(0, 100, n), rng.uniform(table.dp[0], table.dp[-1], n)
    low, high = (np.interp(dp, table.dp, x) for x in (table.lowest, table.highest))
    Q = low + rng.uniform(-0.02, 1.02, n) * (high - low)
    run = Running(file)
    found = run.at(U=U, Q_demand=Q, dp=dp)
    run.close()
    warm = np.full(n, T)
    of_unit = np.abs(found["Q"] - estimator.predict(state, U, dp, warm)[0]).max()
    known = found["U_status"] != InverseStatus.UNIDENTIFIED
    delivered = estimator.predict(state, found["U_required"], dp, warm)[0]
    of_inverse = np.abs(delivered - np.clip(Q, low, high))[known].max()
    exact = invert(estimator, state, Q, dp, T)
    both = known & np.isin(exact.status, DELIVERED)
    assert both.mean() > 0.5
    in_U = np.abs(found["U_required"] - exact.U)[both].max()
    assert of_unit <= tables.forward.error
    assert of_inverse <= table.error_Q
    assert in_U <= table.error_U

    block = FunctionBlock(as_structured_text(table, "V"))
    for k in range(OF_TABLE if n == POINTS else 20):
        said = block(Q=float(Q[k]), dp=float(dp[k]))
        if known[k] and said["status"] != InverseStatus.UNIDENTIFIED:
            assert said["u"] == pytest.approx(found["U_required"][k], abs=1e-6)


def test_a_table_of_a_valve_of_both_directions_is_refused():
    both = FlowMap(U_range=(-100.0, 100.0))
    with pytest.raises(ValueError, match="learn one direction alone"):
        lookup_table(both, both.initial_state(), T=T)
