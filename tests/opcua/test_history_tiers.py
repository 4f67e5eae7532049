"""Aggregates from the tiers of the history equal those of raw values, and say where raw is gone."""

from contextlib import contextmanager

import numpy as np
import pytest
from asyncua import ua

from guarded_opcua.address_space.declarations import Variable
from guarded_opcua.history.aggregate_kinds import Aggregate
from guarded_opcua.history.intervals import Rules
from guarded_opcua.history.processing import Processed, Summarised, aggregated
from valvemap.opcua_results.past import ResultsPast
from valvemap.pipeline.store_ports import Piece
from valvemap.storage.history import HistoryFile

S = 1_000_000_000
START = 1_700_000_100 * S  # a multiple of 5 min
NODE = ua.NodeId("V1.Signals.Q", 2)
VARIABLE = Variable(NODE, ua.VariantType.Double)
SUMMED = Aggregate.AVERAGE, Aggregate.MINIMUM, Aggregate.MAXIMUM, Aggregate.COUNT


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def pieces(n, seed=0, start=START):
    """10 Hz in steps of 0.1: extremes repeat; some Bad, Uncertain, missing; some late."""
    rng = np.random.default_rng(seed)
    t = start + np.arange(n) * S // 10
    values = np.round(rng.normal(100.0, 0.4, n), 1)
    values[rng.random(n) < 0.01] = np.nan
    codes = rng.choice(np.array([0, 0x4000_0000, 0x8000_0000], np.uint32), n, p=[0.9, 0.05, 0.05])
    codes[n // 2 : n // 2 + 500] = 0
    order = np.arange(n)
    order[n // 3 : n // 3 + 50] += 100
    order[n // 3 + 100 : n // 3 + 150] -= 100
    for some in np.array_split(order, max(n // 100, 1)):
        yield Piece("V1.Signals", t[some], codes[some], {"Q": values[some]})


@contextmanager
def stored(folder):
    clock = Clock()
    with HistoryFile(folder / "h", keep_s=1_000.0, trend_s=1e6, clock=clock) as store:
        for piece in pieces(20_000):
            store.save([piece])
        yield store, clock


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A history of 20,000 rows, all kept; tests read it."""
    with stored(tmp_path_factory.mktemp("whole")) as (store, _):
        yield store


@pytest.fixture(scope="module")
def thinned(tmp_path_factory):
    """The same after all sealed rows were forgotten and others written; tests read it."""
    with stored(tmp_path_factory.mktemp("thinned")) as (store, clock):
        store.forget()
        clock.now += 1_001.0
        for piece in pieces(5_000, seed=1, start=START + 2_000 * S):
            store.save([piece])
        store.forget()
        yield store


async def answers(store, aggregate, span, width, *, summarised=True, most=10_000):
    past = ResultsPast(store)

    async def raw(span, skip, most):
        return await past.raw(NODE, span, skip, most)

    async def cells(low, high, width):
        return await past.cells(NODE, low, high, width)

    given = Summarised(past.widths, cells) if summarised else None
    asked = Processed(NODE, aggregate, Rules(), *span, width)
    found, rest = await aggregated(asked, VARIABLE, raw, most, given)
    assert rest is None
    return found


SPANS = {
    "10 s": (START, START + 2_000 * S, 10 * S),
    "5 min": (START, START + 2_100 * S, 300 * S),
    "beyond both ends": (START - 900 * S, START + 3_000 * S, 300 * S),
    "truncated": (START + 10 * S, START + 1_999 * S + 77, 60 * S),
    "one interval": (START + 3 * S + 5, START + 1_777 * S + 9, 0),
    "no multiple of 10 s": (START + 3 * S, START + 1_500 * S, 7 * S),
    "backwards": (START + 1_500 * S, START, 10 * S),
}


@pytest.mark.parametrize("span", SPANS.values(), ids=SPANS)
@pytest.mark.parametrize("aggregate", list(Aggregate))
async def test_they_equal_those_of_raw_values_with_all_bits(whole, aggregate, span):
    *between, width = span
    width = width or abs(between[1] - between[0])
    found = await answers(whole, aggregate, between, width)
    expected = await answers(whole, aggregate, between, width, summarised=False)
    np.testing.assert_array_equal(found.codes, expected.codes)
    np.testing.assert_array_equal(found.source, expected.source)
    usable = expected.codes < 0x8000_0000
    np.testing.assert_allclose(found.values[usable], expected.values[usable], rtol=1e-12)


@pytest.mark.parametrize("aggregate", SUMMED)
async def test_where_raw_values_are_gone_tiers_answer(whole, thinned, aggregate):
    span = START, START + 1_500 * S, 300 * S
    expected = await answers(whole, aggregate, span[:2], span[2])
    assert thinned.read("V1.Signals", "Q", 0, START + 1_000 * S, most=9).t.size == 0
    found = await answers(thinned, aggregate, span[:2], span[2])
    np.testing.assert_array_equal(found.codes, expected.codes)
    np.testing.assert_array_equal(found.values, expected.values)


@pytest.mark.parametrize("aggregate", list(Aggregate))
@pytest.mark.parametrize("backwards", [False, True])
async def test_what_needs_deleted_values_is_bad_and_nothing_else(
    whole, thinned, aggregate, backwards
):
    span = START + 3 * S, START + 2_403 * S
    span = span[::-1] if backwards else span
    expected = await answers(whole, aggregate, span, 60 * S)
    found = await answers(thinned, aggregate, span, 60 * S)
    gone = found.codes == ua.StatusCodes.BadDataUnavailable
    old = found.source < START + 1_600 * S
    assert gone[old].all()
    assert not gone[found.source > START + 2_160 * S].any()
    assert (expected.codes[gone] != ua.StatusCodes.BadDataUnavailable).all()


async def test_half_an_interval_of_deleted_values_is_bad(thinned):
    (code,) = (
        await answers(thinned, Aggregate.COUNT, (START + 3 * S, START + 2_200 * S), 2_197 * S)
    ).codes
    assert code == ua.StatusCodes.BadDataUnavailable
