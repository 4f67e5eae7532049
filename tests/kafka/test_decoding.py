"""One decoder for each kind of message: a value, or why it is rejected, in one line."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pyarrow")

import pyarrow as pa
import structlog

from support import hostile_messages as hostile
from support.fleet import as_messages, block, catalogue, day, feed, group
from valvemap.kafka import decoding
from valvemap.kafka.blocks import write_samples
from valvemap.kafka.commands import Command, Reply, write_message
from valvemap.kafka.decoding import Decoder, Rejected, most_rows
from valvemap.kafka.memory import Memory
from valvemap.kafka.settings import TopicsConfig

KEY = b"north.0"


@pytest.fixture(scope="module")
def known():
    return catalogue()


@pytest.fixture(scope="module")
def decoder(known):
    return Decoder(known)


@pytest.fixture(scope="module")
def plan(known):
    return known.groups["north.0"]


@pytest.fixture(scope="module")
def results(plan):
    found = feed(group(plan), day(plan))
    return next(one for one in found if one[:1] != b"{")


def test_all_honest_messages_of_a_day_are_read(decoder, plan):
    one = group(plan)
    for kind, key, packed in as_messages(day(plan)):
        read = decoder.samples if kind == "samples" else decoder.command
        assert not isinstance(read(key, packed), Rejected)
    for packed in feed(one, day(plan)):
        assert not isinstance(decoder.published(KEY, packed), Rejected)
    assert isinstance(decoder.memory(one.to_bytes()), Memory)


def test_results_of_a_group_before_its_first_block_are_read(decoder, plan):
    """A demand comes before any sample."""
    out = feed(group(plan), [Command("1", "north.0", "V0", "demand", "", (1.0, 2.0))])
    assert [isinstance(decoder.published(KEY, one), Rejected) for one in out] == [False, False]


def test_the_largest_block_of_a_collector_is_within_the_limits(plan, known):
    topics = TopicsConfig(message_mb=0.2)
    rows = most_rows(200_000)
    dice = np.random.default_rng(1)
    sent = block(plan, 1, (rows, 0, 0))
    noise = {name: dice.normal(size=rows) for name in ("U", "p1", "p2", "Q", "T")}
    sent = replace(
        sent, samples=replace(sent.samples, samples=replace(sent.samples.samples, **noise))
    )
    assert not isinstance(Decoder(known, topics).samples(KEY, write_samples(sent)), Rejected)
    found = Decoder(known, topics).samples(KEY, write_samples(block(plan, 1, (rows, 1, 0))))
    assert found == Rejected(f"{rows + 1} rows: at most {rows} are allowed")


def test_messages_under_another_key_or_of_other_valves_are_rejected(decoder, known, plan):
    other = block(known.groups["north.1"], 1, (5, 5))
    sent = write_samples(other)
    assert "under the key north.0" in decoder.samples(KEY, sent).reason
    assert "no group 'south.0'" in decoder.samples(b"south.0", sent).reason
    assert "no group ''" in decoder.samples(None, sent).reason
    assert (
        "no valve 'V3'"
        in decoder.samples(KEY, write_samples(replace(other, group="north.0"))).reason
    )
    command = write_message(Command("1", "north.1", "V3", "approve"))
    assert "under the key north.0" in decoder.command(KEY, command).reason
    reply = write_message(Reply("1", "north.1", 1, done=True))
    assert "under the key north.0" in decoder.published(KEY, reply).reason


def test_results_that_cannot_be_shown_are_rejected_by_their_column(decoder, results):
    n = len(hostile.opened(results)[1]["valve"])
    floats, codes = pa.list_(pa.float64()), pa.array([255] * n, pa.uint8())
    far = pa.array([-1] * n, pa.int64()).cast(pa.timestamp("ns", "UTC"))
    for columns, said in (
        ({"RLS__theta": pa.array([[]] * n, floats)}, "column RLS.theta: lists of 5"),
        ({"RLS__status": codes}, "column RLS.status: 255 is no Status"),
        ({"inverse__status": codes}, "column inverse.status: 255 is no InverseStatus"),
        ({"signals__quality": codes}, "column signals.quality: 255 is no Quality"),
        ({"RML__t": far}, "column RML.t: 0 to"),
        ({"valve": pa.array(["V9"] * n)}, "no valve 'V9'"),
        ({"valve": pa.array(["V0"] * n)}, "its names must differ"),
        ({"waiting": pa.array([["x" * 5_000]] * n)}, "column waiting: texts"),
        ({"inverse__map_U": pa.array([[0.0] * 4] * n)}, "not results: cannot reshape"),
    ):
        assert said in decoder.published(KEY, hostile.with_columns(results, **columns)).reason
    wrong = hostile.with_metadata(results, estimators=["RLS"])
    assert "V0 has the estimators RLS, RML, RBF" in decoder.published(KEY, wrong).reason


def test_results_of_a_worker_that_knows_no_interval_are_read(decoder, results):
    metadata, columns = hostile.opened(results)
    del columns["inverse.lower"], columns["inverse.upper"]
    found = decoder.published(KEY, hostile.closed(metadata, columns))
    assert np.isnan(found.results.inverse.lower).all()


def test_an_unexpected_exception_rejects_one_message_and_its_traceback_is_logged_once(
    known, plan, monkeypatch
):
    def broken(message):
        raise ZeroDivisionError("of a reader")

    monkeypatch.setattr(decoding, "read_samples", broken)
    decoder, sent = Decoder(known), write_samples(block(plan, 1, (5, 5, 5)))
    with structlog.testing.capture_logs() as said:
        found = [decoder.samples(KEY, sent) for _ in range(5)]
    assert found == [Rejected("unexpected ZeroDivisionError: of a reader")] * 5
    assert len([one for one in said if "exc_info" in one]) == 1


def test_a_memory_that_is_damaged_anywhere_is_rejected_or_read(decoder, plan):
    one = group(plan)
    feed(one, day(plan))
    packed, dice, rejected = one.to_bytes(), np.random.default_rng(1), 0
    with structlog.testing.capture_logs() as said:
        for k in range(600):
            damaged = bytearray(packed)
            damaged[dice.integers(2_000 if k % 2 else len(packed))] = dice.integers(256)
            rejected += isinstance(decoder.memory(bytes(damaged)), Rejected)
        rejected += isinstance(decoder.memory(packed[:-1]), Rejected)
    assert rejected > 50
    assert said == []
