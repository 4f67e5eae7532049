"""The speed that an inverse's signal gives, against the four true edges."""

import math
import re
import zlib
from dataclasses import replace

import numpy as np
import pytest

from support.structured_text import FunctionBlock
from valvemap.errors import ConfigurationError
from valvemap.model.axis import AxisGeometry, AxisRegression
from valvemap.model.axis_basis import COMMON, leakage_share
from valvemap.model.axis_fit import AxisFit
from valvemap.model.axis_inverse import axis_table, invert, line_weights
from valvemap.model.kernels.axis_rows import COMPLIANCE, LEAKAGE
from valvemap.storage.axis_tables import axis_block, checksum, write_axis_table
from valvemap.storage.table_text import literal
from valvemap.vocabulary.edges import EDGES
from valvemap.vocabulary.statuses import InverseStatus
from valvemap_rig.directional import DirectionalValve, true_edge_flow

GEOMETRY = AxisGeometry(63, 45, 800, 1.2, 1.2)
VALVE = DirectionalValve()
NAME = "Axis (* by *) valvemap"  # one for all tests: a text is parsed once, for 2 s


class TrueFit(AxisFit):
    """A fit that knows the truth, up to a position."""

    def flow(self, edge, U, dp):
        return true_edge_flow(VALVE, edge, U, dp)

    def flow_std(self, edge, U, dp):
        return 0.1 + 10.0 * (np.asarray(U) > 80)


@pytest.fixture(scope="module")
def table():
    regression = AxisRegression(GEOMETRY, play_percent=2.0)
    size = len(regression.initial_state().b)
    theta, covariance = np.zeros(size), np.eye(size)
    theta[COMMON + COMPLIANCE], theta[COMMON + LEAKAGE] = 1.1, 0.5
    return axis_table(TrueFit(regression, theta, covariance, 0.1, 1.0, 0.0, 0.0))


def demands(n, seed=1):
    rng = np.random.default_rng(seed)
    v = rng.uniform(-500, 500, n)
    pA, pB = rng.uniform(10, 150, n), rng.uniform(10, 150, n)
    return v, pA, pB, rng.uniform(160, 190, n), rng.uniform(1, 6, n)


def test_the_signal_gives_the_demanded_speed(table):
    v, pA, pB, pS, pT = demands(2_000)
    answer = invert(table, v, pA, pB, pS, pT)
    ok = answer.status == InverseStatus.OK
    assert ok.mean() > 0.4
    y = np.abs(answer.U)
    flow = {
        edge: true_edge_flow(VALVE, edge, y, dp)
        for edge, dp in (("PA", pS - pA), ("AT", pA - pT), ("PB", pS - pB), ("BT", pB - pT))
    }
    w_A, w_B = line_weights(GEOMETRY, np.full(2_000, 400.0))
    gap = table.leakage * (pA - pB)
    out = answer.U >= 0
    Q_A = np.where(out, flow["PA"], -flow["AT"]) - gap
    Q_B = np.where(out, -flow["BT"], flow["PB"]) + gap
    reached = (w_A * Q_A - w_B * Q_B) / (6e-3 * (w_A * GEOMETRY.A_A + w_B * GEOMETRY.A_B))
    assert reached[ok] == pytest.approx(v[ok], abs=0.5)  # mm/s
    assert (np.sign(answer.U[ok]) == np.sign(v[ok])).mean() > 0.99


def test_beyond_reach_beyond_the_known_and_not_a_number_are_said(table):
    far = invert(table, [3000, -3000], 50, 50, 180, 2)
    assert far.status.tolist() == [InverseStatus.ABOVE_REACH] * 2
    assert far.U.tolist() == [100, -100]
    fast = invert(table, np.linspace(0, 700, 200), 40, 60, 180, 2)
    known = fast.status == InverseStatus.OK
    assert fast.U[known].max() <= 80
    assert (fast.status == InverseStatus.EXTRAPOLATING).any()
    none = invert(table, [math.nan, 1.0], [50, math.inf], 50, 180, 2)
    assert none.status.tolist() == [InverseStatus.NOT_FINITE] * 2
    assert np.isnan(none.U).all()


def test_the_interval_holds_the_signal_and_widens_with_the_uncertainty(table):
    near = invert(table, *demands(500))
    ok = near.status == InverseStatus.OK
    assert (near.lower[ok] <= near.U[ok]).all()
    assert (near.U[ok] <= near.upper[ok]).all()
    wide = invert(replace(table, spread=4 * table.spread), *demands(500))
    assert (wide.upper - wide.lower)[ok].mean() > 2 * (near.upper - near.lower)[ok].mean()


def test_a_batch_is_its_rows(table):
    whole = invert(table, *demands(50))
    rows = [invert(table, *(column[k] for column in demands(50))) for k in range(50)]
    for column, cut in zip(whole, zip(*rows, strict=True), strict=True):
        assert column.tobytes() == np.concatenate(cut).tobytes()


def test_at_rest_without_leakage_the_signal_is_zero(table):
    tight = replace(table, leakage=0.0)
    assert invert(tight, 0.0, 50, 90, 180, 2).U.tolist() == [0.0]


def test_the_metering_edge_is_the_one_with_the_drop(table):
    starved = invert(table, [200.0, 200.0], [175.0, 60.0], [150.0, 2.5], 180, 2)
    assert [EDGES[k] for k in starved.edge] == ["BT", "PA"]


@pytest.mark.parametrize("points", [2_000, pytest.param(10_000, marks=pytest.mark.soak)])
def test_the_function_block_computes_the_inverse(table, points):
    """As blark reads it, and by the standard's rules (`support/structured_text.py`)."""
    run = FunctionBlock(axis_block(table, NAME, 7))
    columns = demands(points, seed=2)
    answer = invert(table, *columns)
    answers = [
        run(v=v, pA=pA, pB=pB, pS=pS, pT=pT).copy()
        for v, pA, pB, pS, pT in zip(*columns, strict=True)
    ]
    assert [one["status"] for one in answers] == answer.status.tolist()
    assert np.max(np.abs([one["u"] for one in answers] - answer.U)) < 1e-9
    assert len(set(answer.status.tolist())) >= 3
    assert answers[-1]["version"] == 7
    assert answers[-1]["crc"] == checksum(table)
    found = run(v=math.nan, pA=50.0, pB=50.0, pS=180.0, pT=2.0)
    assert found["u"] == pytest.approx(answer.U[-1], abs=1e-9)  # keeps its value
    assert found["status"] == InverseStatus.NOT_FINITE


def test_the_function_block_leaks_as_oil_of_its_temperature_does(table):
    run = FunctionBlock(axis_block(table, NAME, 7))
    columns = demands(40, seed=3)
    for T in (-10.0, 65.0, math.nan):
        leaking = replace(table, leakage=leakage_share(T) * table.leakage)
        answer = invert(leaking, *columns)
        rows = zip(*columns, strict=True)
        found = [run(v=v, pA=a, pB=b, pS=s, pT=t, T=T)["u"] for v, a, b, s, t in rows]
        assert np.max(np.abs(np.array(found) - answer.U)) < 1e-9, T


def test_the_checksum_is_of_the_literals_in_the_block(table):
    text = axis_block(table, "V", 1)
    listed = [found[1] for found in re.finditer(r":= \[(.*?)\]", text, re.DOTALL)]
    literals = [x.strip() for part in listed for x in part.split(",") if "." in x]
    rest = [*table.known, table.leakage]
    assert zlib.crc32(",".join([*literals, *map(literal, rest)]).encode()) == checksum(table)
    assert checksum(replace(table, leakage=table.leakage * 1.01)) != checksum(table)


def test_an_axis_is_written_as_structured_text_alone(table, tmp_path):
    file = tmp_path / "axis.st"
    write_axis_table(file, table, "Axis", 3)
    assert "FUNCTION_BLOCK FB_AxisRequiredU" in file.read_text(encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"ends in \.st"):
        write_axis_table(tmp_path / "axis.c", table, "Axis", 3)
