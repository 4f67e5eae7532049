"""Blocks come back as they were, to the bit; what is none is refused in one line."""

import json
import re
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from support.plant import START, plant
from valvemap.pipeline.operator_ports import Command

pa = pytest.importorskip("pyarrow")

from valvemap.app.build import build_identification  # noqa: E402 - the extra first
from valvemap.config.models import Config  # noqa: E402
from valvemap.config.valves import ValveConfig  # noqa: E402
from valvemap.errors import BlockError  # noqa: E402
from valvemap.kafka.blocks import (  # noqa: E402
    Head,
    SamplesBlock,
    read,
    read_samples,
    write,
    write_samples,
)
from valvemap.kafka.result_blocks import (  # noqa: E402
    KnownVersion,
    ResultsBlock,
    read_results,
    write_results,
)
from valvemap.model.samples import Samples, Segments  # noqa: E402
from valvemap.pipeline.alarm_results import AlarmResults  # noqa: E402
from valvemap.pipeline.by_valve import ByValve  # noqa: E402

VALVES = ("a", "b", "c", "d")


def block(lengths, number=1, **columns):
    """Samples of some valves; of those with no sample there is no segment."""
    samples = Samples.concatenate([plant(n, seed=k) for k, n in enumerate(lengths)])
    edges = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    members = np.flatnonzero(np.diff(edges))
    segments = Segments(members, edges[members], edges[members + 1])
    return SamplesBlock("north.0", number, VALVES, ByValve(replace(samples, **columns), segments))


def bits(thing):
    """All that something holds, to the bit, shapes and types included."""
    if isinstance(thing, AlarmResults):
        reports = [bits(thing.reports(m)) if n else [] for m, n in enumerate(thing.version)]
        return bits(thing.version), reports
    if hasattr(thing, "__dataclass_fields__"):
        return {f.name: bits(getattr(thing, f.name)) for f in fields(thing)}
    if isinstance(thing, dict):
        return {name: bits(value) for name, value in thing.items()}
    if isinstance(thing, np.ndarray):
        return thing.dtype.str, thing.shape, thing.tobytes()
    if isinstance(thing, list | tuple):
        return [bits(one) for one in thing]
    return repr(thing)


@given(
    st.lists(st.integers(0, 5), min_size=4, max_size=4),
    st.integers(1, 2**62),
    st.data(),
)
def test_samples_come_back_to_the_bit_whatever_they_hold(lengths, number, data):
    n = sum(lengths)
    any_float = arrays.arrays(np.float64, n, elements=st.floats(allow_nan=True, width=64))
    columns = {name: data.draw(any_float) for name in ("U", "p1", "p2", "Q", "T")}
    t = data.draw(arrays.arrays(np.int64, n, elements=st.integers(-(2**63), 2**63 - 1)))
    quality = data.draw(arrays.arrays(np.uint8, n, elements=st.integers(0, 2)))
    sent = block(lengths, number, t=t, quality=quality, **columns)
    found = read_samples(write_samples(sent))
    assert bits(found.samples) == bits(sent.samples)
    assert (found.group, found.number, found.valves) == ("north.0", number, VALVES)
    assert all(getattr(found.samples.samples, f.name).flags.writeable for f in fields(Samples))


def test_rows_of_valves_that_stand_mixed_are_parted_in_their_order():
    sent = block((3, 0, 2, 4))
    whole = pa.ipc.open_stream(write_samples(sent)).read_all()
    mixed = whole.take([8, 0, 3, 1, 7, 2, 4, 6, 5])
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, mixed.schema) as stream:  # a foreign writer's, not packed
        stream.write_batch(mixed.combine_chunks().to_batches()[0])
    found = read_samples(sink.getvalue().to_pybytes())
    assert found.samples.segments.members.tolist() == [0, 2, 3]
    expected = sent.samples.samples[np.array([0, 1, 2, 3, 4, 8, 7, 6, 5])]
    assert bits(found.samples.samples) == bits(expected)


@pytest.fixture(scope="module")
def identification():
    found = build_identification(Config(valves=tuple(ValveConfig(name=name) for name in VALVES)))
    for valve in range(3):  # the last one has seen nothing yet
        found.take_samples(valve, plant(150, seed=valve))
    late = np.array([START + 60_000_000_000])
    found.say_overdue(np.array([0]), late)
    found.maps.refresh()
    found.do(Command.of("demand", "a", 60.0, 100.0))
    found.do(Command.of("approve", "b"))
    return found


def test_results_come_back_to_the_bit(identification):
    (results,) = identification.results.of(range(4))
    found = read_results(write_results(ResultsBlock("north.0", 9, VALVES, results)))
    baseline = results.baselines[1]
    named = KnownVersion(baseline.version, baseline.t, baseline.digest)
    expected = replace(results, baselines=[None, named, None, None])
    assert (found.group, found.number, found.valves) == ("north.0", 9, VALVES)
    assert bits(found.results) == bits(expected)
    assert found.results.estimators["Auto"].survey[0] is not None
    assert any(report.active for report in found.results.alarms.reports(0))
    assert found.results.alarms.reports(3) == ()


def test_results_of_some_valves_name_them(identification):
    (results,) = identification.results.of([3, 1])
    found = read_results(write_results(ResultsBlock("north.0", 9, VALVES, results)))
    assert found.valves == ("d", "b")


def test_a_foreign_reader_sees_what_the_schema_says():
    stream = pa.ipc.open_stream(write_samples(block((2, 1, 0, 0))))
    said = {key.decode(): json.loads(value) for key, value in stream.schema.metadata.items()}
    assert said == {
        "valvemap.block": "samples",
        "valvemap.version": 1,
        "valvemap.group": "north.0",
        "valvemap.number": 1,
        "valvemap.catalogue": 0,
    }
    rows = stream.read_all()
    assert rows["valve"].to_pylist() == ["a", "a", "b"]
    assert rows["t"].cast(pa.int64()).to_pylist() == [START, START + 10_000_000, START]


def foreign(metadata, **columns):
    schema = pa.schema([(name, column.type) for name, column in columns.items()], metadata)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, schema) as stream:
        stream.write_batch(pa.RecordBatch.from_arrays(list(columns.values()), schema=schema))
    return sink.getvalue().to_pybytes()


HEAD = {
    "valvemap.block": '"samples"',
    "valvemap.version": "1",
    "valvemap.group": '"g"',
    "valvemap.number": "1",
}
X = {"x": pa.array([1.0])}


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (b"", "not an Arrow IPC stream"),
        (b"{}", "not an Arrow IPC stream"),
        (b"\xff\xff\xff\xff\x00\x00\x00\x7f", "not an Arrow IPC stream"),
        (foreign({}, **X), "not a block of valvemap"),
        (foreign({**HEAD, "valvemap.version": "2"}, **X), "a block of version 2, this one knows 1"),
        (foreign({**HEAD, "valvemap.version": "[[["}, **X), "metadata valvemap.version: not JSON"),
        (foreign({**HEAD, "valvemap.block": '"results"'}, **X), "a block of results, not of"),
        (foreign({**HEAD, "valvemap.number": "0"}, **X), "its number from 1"),
        (foreign({**HEAD, "valvemap.group": "7"}, **X), "a block says its group"),
        (foreign(HEAD, **X), "column valve is missing"),
        (foreign(HEAD, valve=pa.array(["a"])), "column valve is of type string, not dictionary"),
    ],
)
def test_what_is_no_block_is_refused_in_one_line(message, said):
    with pytest.raises(BlockError, match=re.escape(said)) as refused:
        read_samples(message)
    assert len(str(refused.value).splitlines()) == 1


def test_columns_that_are_not_as_the_schema_says_are_named():
    head = Head("samples", "g", 1, {})
    valve = pa.array(["a", "b"]).cast(pa.dictionary(pa.int32(), pa.string()))
    twice = pa.DictionaryArray.from_arrays(pa.array([0, 1], pa.int32()), ["a", "a"])
    whole = {
        "valve": valve,
        "t": pa.array([1, 2], pa.timestamp("ns", "UTC")),
        **{name: pa.array([1.0, 2.0]) for name in ("U", "p1", "p2", "Q", "T")},
        "quality": pa.array([0, 1], pa.uint8()),
    }
    assert len(read_samples(write(head, whole)).samples.samples) == 2
    for name, other, said in (
        ("Q", pa.array([1.0, None]), "column Q has 1 nulls"),
        ("t", pa.array([1, 2]), "column t is of type int64, not timestamp"),
        ("quality", pa.array([0, 3], pa.uint8()), "column quality: 0, 1 and 2"),
        ("valve", twice, "its names must differ"),
    ):
        with pytest.raises(BlockError, match=said):
            read_samples(write(head, {**whole, name: other}))


def test_results_with_lists_of_another_length_are_refused(identification):
    (results,) = identification.results.of(range(4))
    message = write_results(ResultsBlock("g", 1, VALVES, results))
    head, batch = read(message, "results")
    columns = dict(zip(batch.schema.names, batch.columns, strict=True))
    uneven = pa.array([[1.0], [1.0, 2.0], [], [1.0]])
    with pytest.raises(BlockError, match=r"RLS\.theta: its lists must be of equal length"):
        read_results(write(head, {**columns, "RLS.theta": uneven}))
    with pytest.raises(BlockError, match=r"metadata valvemap\.counters: a list of names"):
        read_results(write(head._replace(more={**head.more, "counters": 3}), columns))


def test_damage_anywhere_is_refused_or_read_and_never_more(identification):
    rng = np.random.default_rng(7)
    (results,) = identification.results.of(range(4))
    whole = (
        (read_samples, write_samples(block((20, 20, 20, 20)))),
        (read_results, write_results(ResultsBlock("g", 1, VALVES, results))),
    )
    refused = []
    for reader, message in whole:
        for trial in range(400):
            damaged = bytearray(message)
            for place in rng.integers(0, len(message), 1 + trial % 4):
                damaged[place] = rng.integers(256)
            if trial % 5 == 0:
                del damaged[rng.integers(len(damaged)) :]
            try:
                reader(bytes(damaged))
            except BlockError as error:
                refused.append(str(error))
    assert len(refused) > 200
    assert [said for said in refused if "\n" in said] == []
