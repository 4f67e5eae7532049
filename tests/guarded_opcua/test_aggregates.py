"""Aggregates of a variable's past: cases computed by hand, any cutting, over a real socket."""

# ruff: noqa: FBT003 - positional fields of OPC UA structures

import datetime as dt
import statistics

import numpy as np
import pytest
import pytest_asyncio
from asyncua import ua
from hypothesis import given
from hypothesis import strategies as st

from guarded_opcua import (
    HardenedServer,
    Limits,
    Records,
    ServerSettings,
    add_object,
    add_variable,
)
from guarded_opcua.history.aggregate_kinds import Aggregate
from guarded_opcua.history.aggregates import Aggregation
from guarded_opcua.history.intervals import Intervals, Rules
from support.served import patient

GOOD, UNCERTAIN, BAD = 0, 0x408F0000, 0x80890000
CALCULATED, INTERPOLATED, PARTIAL, MANY = 0x401, 0x402, 0x404, 0x410
SUB_NORMAL, NO_DATA = 0x40A40000, 0x809B0000
S = 1_000_000_000
T0 = 1_800_000_000 * S

# s, value, status: an interval of 10 s each way of being good, in doubt, and empty
PAST = (
    *((0, 10.0, GOOD), (2, 20.0, GOOD), (5, 5.0, GOOD), (9, 20.0, GOOD)),  # 0 to 10
    *((11, 8.0, GOOD), (13, 99.0, BAD), (15, 4.0, GOOD)),  # 10 to 20: one is Bad
    *((21, 6.0, GOOD), (25, 1.0, UNCERTAIN), (29, 10.0, GOOD)),  # 20 to 30: one in doubt
    *((30, 3.0, BAD), (35, 3.0, BAD)),  # 30 to 40: all are Bad
    (51, 7.0, GOOD),  # 40 to 50: none; 50 to 60 ends without one
)


def records(past=PAST):
    t, values, codes = (np.array(x) for x in zip(*past, strict=True))
    t = T0 + t.astype(np.int64) * S
    return Records(values.astype(float), codes.astype(np.uint32), t, t)


def aggregated(aggregate, past=PAST, rules=None, start=0, end=60, width=10, **how):
    intervals, _ = Intervals.of(T0 + start * S, T0 + end * S, width * S, most=1_000)
    found = Aggregation(aggregate, intervals, rules or Rules(), stepped=how.get("stepped", False))
    taken = records(past)
    rows = slice(None, None, -1) if start > end else slice(None)
    cuts = how.get("cuts", ())
    for first, last in zip((0, *cuts), (*cuts, len(past)), strict=True):
        found.take(
            Records(
                *(
                    getattr(taken, name)[rows][first:last]
                    for name in ("values", "codes", "source", "server")
                )
            )
        )
    return found.records()


@pytest.mark.parametrize(
    ("aggregate", "values", "codes"),
    [
        (
            Aggregate.AVERAGE,
            [13.75, 6.0, 8.0, None, None, 7.0],
            [
                *(CALCULATED, SUB_NORMAL | CALCULATED, SUB_NORMAL | CALCULATED),
                *(NO_DATA, NO_DATA, CALCULATED | PARTIAL),
            ],
        ),
        (
            Aggregate.MINIMUM,
            [5.0, 4.0, 6.0, None, None, 7.0],
            [
                *(CALCULATED, SUB_NORMAL | CALCULATED, SUB_NORMAL | CALCULATED),
                *(NO_DATA, NO_DATA, CALCULATED | PARTIAL),
            ],
        ),
        (
            Aggregate.MAXIMUM,  # twice 20 in the first: many values
            [20.0, 8.0, 10.0, None, None, 7.0],
            [
                *(CALCULATED | MANY, SUB_NORMAL | CALCULATED, SUB_NORMAL | CALCULATED),
                *(NO_DATA, NO_DATA, CALCULATED | PARTIAL),
            ],
        ),
        (
            Aggregate.COUNT,
            [4, 2, 2, None, 0, 1],
            [
                *(CALCULATED, SUB_NORMAL | CALCULATED, SUB_NORMAL | CALCULATED),
                *(0x80000000, CALCULATED, CALCULATED | PARTIAL),
            ],
        ),
        (
            Aggregate.INTERPOLATIVE,  # 9 s: 20, 11 s: 8; 15 s: 4, 21 s: 6; 29 s: 10, 51 s: 7
            [10.0, 14.0, 4 + 5 / 3, 10 - 3 / 22, 10 - 33 / 22, 10 - 63 / 22],
            [GOOD, INTERPOLATED, INTERPOLATED, *(3 * [SUB_NORMAL | INTERPOLATED])],
        ),
    ],
    ids=lambda x: x.name if isinstance(x, Aggregate) else "",
)
def test_what_is_computed_by_hand(aggregate, values, codes):
    found = aggregated(aggregate)
    assert [hex(code) for code in found.codes] == [hex(code) for code in codes]
    for k, value in enumerate(values):
        assert value is None or found.values[k] == pytest.approx(value)
    np.testing.assert_array_equal(found.source, T0 + np.arange(6) * 10 * S)


@pytest.mark.parametrize(
    ("aggregate", "values", "codes", "times"),
    [
        (
            Aggregate.START,
            [10.0, 8.0, 6.0, 3.0, None, 7.0],
            [GOOD, GOOD, GOOD, BAD, NO_DATA, GOOD],
            [0, 11, 21, 30, 40, 51],
        ),
        (
            Aggregate.END,
            [20.0, 4.0, 10.0, 3.0, None, 7.0],
            [GOOD, GOOD, GOOD, BAD, NO_DATA, GOOD],
            [9, 15, 29, 35, 40, 51],
        ),
        (
            Aggregate.MINIMUM_ACTUAL_TIME,
            [5.0, 4.0, 6.0, None, None, 7.0],
            [GOOD, SUB_NORMAL, SUB_NORMAL, NO_DATA, NO_DATA, PARTIAL],
            [5, 15, 21, 30, 40, 51],
        ),
        (
            Aggregate.MAXIMUM_ACTUAL_TIME,  # the first of two
            [20.0, 8.0, 10.0, None, None, 7.0],
            [MANY, SUB_NORMAL, SUB_NORMAL, NO_DATA, NO_DATA, PARTIAL],
            [2, 11, 29, 30, 40, 51],
        ),
    ],
    ids=lambda x: x.name if isinstance(x, Aggregate) else "",
)
def test_what_has_a_time_of_its_own(aggregate, values, codes, times):
    found = aggregated(aggregate)
    assert [hex(code) for code in found.codes] == [hex(code) for code in codes]
    for k, value in enumerate(values):
        assert value is None or found.values[k] == value
    assert ((found.source - T0) // S).tolist() == times


@pytest.mark.parametrize(
    ("aggregate", "values"),
    [
        (Aggregate.RANGE, [15.0, 4.0, 4.0, None, None, 0.0]),
        (Aggregate.DELTA, [10.0, -4.0, 4.0, None, None, 0.0]),
        (Aggregate.DURATION_GOOD, [10_000.0, 8_000.0, 6_000.0, 0.0, 0.0, 9_000.0]),
        (Aggregate.DURATION_BAD, [0.0, 2_000.0, 4_000.0, 10_000.0, 10_000.0, 1_000.0]),
        (Aggregate.PERCENT_GOOD, [100.0, 80.0, 60.0, 0.0, 0.0, 90.0]),
        (Aggregate.PERCENT_BAD, [0.0, 20.0, 40.0, 100.0, 100.0, 10.0]),
    ],
    ids=lambda x: x.name if isinstance(x, Aggregate) else "",
)
def test_differences_and_durations_by_hand(aggregate, values):
    found = aggregated(aggregate)
    for k, value in enumerate(values):
        assert value is None or found.values[k] == pytest.approx(value)
        if value is None:
            assert found.codes[k] == NO_DATA


def test_the_total_is_the_time_average_times_its_duration():
    total, average = (aggregated(a) for a in (Aggregate.TOTAL, Aggregate.TIME_AVERAGE))
    np.testing.assert_allclose(total.values, 10.0 * average.values)
    np.testing.assert_array_equal(total.codes, average.codes)


def test_the_average_over_time_is_the_area_below_the_line():
    found = aggregated(Aggregate.TIME_AVERAGE, end=20)
    assert found.values[0] == pytest.approx((15 * 2 + 12.5 * 3 + 12.5 * 4 + 17 * 1) / 10)
    at_20 = 4 + 5 / 3
    assert found.values[1] == pytest.approx((11 * 1 + 6 * 4 + (4 + at_20) / 2 * 5) / 10)
    assert [hex(code) for code in found.codes] == [
        hex(CALCULATED),
        hex(SUB_NORMAL | CALCULATED),
    ]


def test_what_is_counted_stays_until_it_changes():
    past = ((0, 1.0, GOOD), (4, 3.0, GOOD), (14, 5.0, GOOD))
    found = aggregated(Aggregate.TIME_AVERAGE, past, end=10, stepped=True)
    assert found.values[0] == pytest.approx((4 * 1 + 6 * 3) / 10)
    found = aggregated(Aggregate.INTERPOLATIVE, past, end=20, stepped=True)
    assert found.values.tolist() == [1.0, 3.0]


def test_a_minimum_at_the_start_is_raw():
    found = aggregated(Aggregate.MINIMUM, ((0, 1.0, GOOD), (5, 2.0, GOOD), (10, 3.0, GOOD)), end=10)
    assert found.codes.tolist() == [GOOD]


def test_before_and_behind_all_values_there_are_none_but_the_last():
    past = ((20, 4.0, GOOD), (25, 6.0, GOOD))
    average = aggregated(Aggregate.AVERAGE, past)
    assert [code == NO_DATA for code in average.codes] == [True, True, False, True, True, True]
    drawn = aggregated(Aggregate.INTERPOLATIVE, past)
    assert drawn.codes[:2].tolist() == [NO_DATA] * 2
    assert drawn.values[3:].tolist() == [6.0] * 3
    assert (drawn.codes[3:] == SUB_NORMAL | INTERPOLATED).all()
    ahead = aggregated(Aggregate.INTERPOLATIVE, past, Rules(sloped=True))
    assert ahead.values[3] == pytest.approx(8.0)


@pytest.mark.parametrize(
    ("rules", "code"),
    [
        (Rules(percent_good=60, percent_bad=50), CALCULATED),
        (Rules(percent_good=70, percent_bad=50), SUB_NORMAL | CALCULATED),
        (Rules(percent_good=80, percent_bad=30), 0x80000000),
    ],
)
def test_shares_decide_how_good_an_average_is(rules, code):
    found = aggregated(Aggregate.AVERAGE, rules=rules, start=10, end=20)
    assert hex(found.codes[0]) == hex(code)


def test_backwards_the_later_time_begins_an_interval():
    past = ((0, 1.0, GOOD), (10, 2.0, GOOD), (20, 3.0, GOOD))
    found = aggregated(Aggregate.AVERAGE, past, start=20, end=0)
    assert ((found.source - T0) // S).tolist() == [20, 10]
    assert found.values.tolist() == [3.0, 2.0]


PASTS = st.lists(
    st.tuples(
        st.integers(0, 70), st.floats(-100, 100), st.sampled_from([GOOD, GOOD, UNCERTAIN, BAD])
    ),
    min_size=1,
    max_size=30,
).map(lambda past: tuple(sorted(past)))


@given(past=PASTS, data=st.data(), aggregate=st.sampled_from(list(Aggregate)))
def test_it_does_not_matter_in_what_pieces_values_come(past, data, aggregate):
    cuts = sorted(data.draw(st.lists(st.integers(0, len(past)), max_size=3)))
    whole = aggregated(aggregate, past, start=3, end=57)
    cut = aggregated(aggregate, past, start=3, end=57, cuts=cuts)
    np.testing.assert_array_equal(cut.codes, whole.codes)
    there = whole.codes < 0x80000000
    np.testing.assert_allclose(cut.values[there], whole.values[there], rtol=1e-12, atol=1e-9)


@given(past=PASTS)
def test_sums_and_extremes_are_those_of_a_plain_loop(past):
    found = {a: aggregated(a, past) for a in (Aggregate.AVERAGE, Aggregate.MAXIMUM)}
    for k in range(6):
        inside = [v for t, v, code in past if 10 * k <= t < 10 * k + 10 and code == GOOD]
        average, largest = (found[a] for a in (Aggregate.AVERAGE, Aggregate.MAXIMUM))
        assert (average.codes[k] < 0x80000000) == bool(inside)
        if inside:
            assert average.values[k] == pytest.approx(sum(inside) / len(inside), abs=1e-9)
            assert largest.values[k] == max(inside)
            assert bool(largest.codes[k] & 0x10) == (inside.count(max(inside)) > 1)


SPREADS = {
    Aggregate.STANDARD_DEVIATION_SAMPLE: statistics.stdev,
    Aggregate.STANDARD_DEVIATION_POPULATION: statistics.pstdev,
    Aggregate.VARIANCE_SAMPLE: statistics.variance,
    Aggregate.VARIANCE_POPULATION: statistics.pvariance,
}


@given(past=PASTS, aggregate=st.sampled_from(list(SPREADS)))
def test_spreads_are_those_of_the_standard_library(past, aggregate):
    found = aggregated(aggregate, past)
    for k in range(6):
        inside = [v for t, v, code in past if 10 * k <= t < 10 * k + 10 and code == GOOD]
        assert (found.codes[k] < 0x80000000) == bool(inside)
        if inside:
            expected = SPREADS[aggregate](inside) if len(inside) > 1 else 0.0
            assert found.values[k] == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(past=PASTS)
def test_durations_are_those_of_a_plain_loop(past):
    good = aggregated(Aggregate.DURATION_GOOD, past)
    bad = aggregated(Aggregate.DURATION_BAD, past)
    ends = [t for t, _, _ in past[1:]] + [60]
    for k in range(6):
        seconds = [0.0, 0.0]
        for (t, _, code), end in zip(past, ends, strict=True):
            overlap = max(min(end, 10 * k + 10) - max(t, 10 * k), 0)
            seconds[code != GOOD] += overlap
        if good.codes[k] < 0x80000000:
            assert good.values[k] == pytest.approx(1e3 * seconds[0], abs=1e-6)
            assert bad.values[k] == pytest.approx(1e3 * seconds[1], abs=1e-6)


class Kept:
    """Fulfils Historian."""

    def __init__(self, kept):
        self.kept = kept

    def raw(self, _variable, span, skip, most):
        rows = np.flatnonzero((self.kept.source >= span.low) & (self.kept.source <= span.high))
        rows = (rows[::-1] if span.backwards else rows)[skip : skip + most]
        return Records(*(x[rows] for x in vars(self.kept).values()))


@pytest_asyncio.fixture(loop_scope="function")
async def served():
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/aggregates/",
        application_uri="urn:test:aggregates",
        application_name="aggregates",
        namespace_uri="urn:aggregates",
        none_on_loopback=True,
        limits=Limits(history_values=4),
    )
    server = await HardenedServer.create(settings)
    folder = await add_object(server, None, "Plant")
    flow = await add_variable(server, folder, "Plant.Flow", 0.0)
    server.add_history([flow], Kept(records()))
    async with server, patient(server.url) as client:
        yield client, flow


def moment(seconds):
    return dt.datetime.fromtimestamp(T0 // S + seconds, dt.UTC)


def details(aggregate=Aggregate.AVERAGE, start=0, end=60, width=10_000.0, **config):
    default = ua.AggregateConfiguration(not config, *(config.values() or (True, 100, 100, False)))
    kind = ua.NodeId(int(aggregate))
    return ua.ReadProcessedDetails(moment(start), moment(end), width, [kind], default)


async def read(client, node, details, point=None):
    wanted = [ua.HistoryReadValueId(NodeId=node.id, ContinuationPoint=point)]
    request = ua.HistoryReadRequest()
    request.Parameters = ua.HistoryReadParameters(
        details, ua.TimestampsToReturn.Both, False, wanted
    )
    data = await client.uaclient.protocol.send_request(request)
    response = ua.ua_binary.struct_from_binary(ua.HistoryReadResponse, data)
    return response.Results[0]


async def test_a_client_reads_aggregates_a_page_at_a_time(served):
    client, flow = served
    first = await read(client, flow, details())
    rest = await read(client, flow, details(), first.ContinuationPoint)
    values = [value for page in (first, rest) for value in page.HistoryData.DataValues]
    assert rest.ContinuationPoint is None
    expected = aggregated(Aggregate.AVERAGE)
    assert [value.StatusCode.value for value in values] == expected.codes.tolist()
    assert [v.Value.Value for v in values[:3]] == expected.values[:3].tolist()


async def test_a_client_reads_values_at_times_of_its_own(served):
    client, flow = served
    times = [moment(seconds) for seconds in (10, 0, 2)]
    found = await read(client, flow, ua.ReadAtTimeDetails(times, False))
    values = found.HistoryData.DataValues
    assert [value.Value.Value for value in values] == [14.0, 10.0, 20.0]
    assert [value.StatusCode.value for value in values] == [INTERPOLATED, GOOD, GOOD]


@pytest.mark.parametrize(
    ("asked", "code"),
    [
        (details(start=5, end=5), "BadInvalidArgument"),
        (details(width=-1.0), "BadInvalidArgument"),
        (details(width=float("nan")), "BadInvalidArgument"),
        (details(ua.ObjectIds.AggregateFunction_NumberOfTransitions), "BadAggregateNotSupported"),
        (
            details(uncertain=True, bad=101, good=100, sloped=False),
            "BadAggregateConfigurationRejected",
        ),
        (ua.ReadAtTimeDetails([], False), "BadInvalidArgument"),
        (ua.ReadAtTimeDetails([moment(0)] * 5, False), "BadTooManyOperations"),
    ],
    ids=["no span", "negative", "nan", "other aggregate", "shares", "no times", "too many"],
)
async def test_what_cannot_be_read_is_said(served, asked, code):
    client, flow = served
    found = await read(client, flow, asked)
    assert found.StatusCode.name == code


async def test_each_variable_needs_an_aggregate_of_its_own(served):
    client, flow = served
    with pytest.raises(ua.UaStatusCodeError, match="BadAggregateListMismatch"):
        await read(client, flow, ua.ReadProcessedDetails())


async def test_clients_find_the_functions_where_they_look_for_them(served):
    client, _ = served
    for folder in (
        ua.ObjectIds.HistoryServerCapabilities_AggregateFunctions,
        ua.ObjectIds.Server_ServerCapabilities_AggregateFunctions,
    ):
        shown = await client.get_node(ua.NodeId(folder)).get_children()
        assert {node.nodeid.Identifier for node in shown} == set(Aggregate)
