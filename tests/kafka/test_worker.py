"""Workers that fail, and hand groups to each other, come to what one that never stops comes to."""

from dataclasses import replace

import numpy as np
import pytest

from support.soaked import soaked

pytest.importorskip("pyarrow")

import structlog

from support.bulkheads import CULPRIT, LANES, MARK, STEPS, VALVES, Injected, broken
from support.fleet import RHYTHM, Dictionary, as_messages, block, catalogue, day, feed, group
from valvemap.errors import FleetError
from valvemap.kafka import worker as worker_module
from valvemap.kafka.blocks import write_samples
from valvemap.kafka.commands import Command, is_reply, read_reply, write_message
from valvemap.kafka.group import Group
from valvemap.kafka.memory import read_memory, write_memory
from valvemap.kafka.result_blocks import read_results
from valvemap.kafka.settings import TopicsConfig
from valvemap.kafka.worker import MEMORY, Worker
from valvemap.pipeline.baseline import Baseline
from valvemap.pipeline.lane_failures import Step
from valvemap.vocabulary.statuses import Status

GROUPS = ("north.0", "north.1")


@pytest.fixture(scope="module")
def known():
    return catalogue()


@pytest.fixture(scope="module")
def stream(known):
    """Messages of two groups, one after the other."""
    days = [list(as_messages(day(known.groups[name], seed=k))) for k, name in enumerate(GROUPS)]
    return [message for pair in zip(*days, strict=True) for message in pair]


def run(worker, stores, message):
    kind, key, packed = message
    take = worker.samples if kind == "samples" else worker.command
    return take(key, packed, stores[key.decode()])


@pytest.fixture(scope="module")
def undisturbed(known):
    found = {}
    for k, name in enumerate(GROUPS):
        one = group(known.groups[name])
        found[name] = feed(one, day(known.groups[name], seed=k)), one.to_bytes()
    return found


@pytest.mark.parametrize("seed", [0, 1, *soaked(2, 3)])
def test_whoever_learns_and_whatever_is_rolled_back_the_bits_are_the_same(
    known, stream, undisturbed, seed
):
    """Transactions of any length, committed or aborted, by any of three workers."""
    rng = np.random.default_rng(seed)
    workers = [Worker(known, RHYTHM) for _ in range(3)]
    stores = {name: Dictionary() for name in GROUPS}
    out = {name: [] for name in GROUPS}
    at = 0
    while at < len(stream):
        worker = workers[rng.integers(3)]
        if rng.random() < 0.1:  # killed
            workers[workers.index(worker)] = worker = Worker(known, RHYTHM)
        some = stream[at : at + int(rng.integers(1, 6))]
        said = [(message[1].decode(), run(worker, stores, message)) for message in some]
        committed = rng.random() < 0.6
        if committed or rng.random() < 0.5:  # a commit may fail, too
            worker.keep()
        for store in stores.values():
            store.commit() if committed else store.abort()
        if committed:
            at += len(some)
            for name, one in said:
                out[name] += one
    for name in GROUPS:
        assert out[name] == undisturbed[name][0]
        assert stores[name].kept[MEMORY] == undisturbed[name][1]


def test_messages_that_cannot_be_read_are_counted_said_and_handed_over_as_dead_letters(known):
    worker, store = Worker(known, RHYTHM), Dictionary()
    with structlog.testing.capture_logs() as said:
        assert worker.samples(b"north.0", b"nonsense", store) == []
        assert worker.command(b"north.0", b"nonsense", store) == []
        assert worker.samples(b"south.7", b"nonsense", store) == []
        assert worker.samples(None, b"", store) == []
    warnings = [(one["group"], one["reason"]) for one in said if one["log_level"] == "warning"]
    assert [name for name, _ in warnings] == ["north.0", "north.0", "south.7", ""]
    assert warnings[1] == ("north.0", "not a command: not JSON")
    letters = worker.rejected()
    assert [one.reason for one in letters] == [reason for _, reason in warnings]
    assert [one.key for one in letters] == [b"north.0", b"north.0", b"south.7", b""]
    assert worker.rejected() == []
    one = Group(known.groups["north.0"], 1, RHYTHM)
    worker.keep()
    one.remember(store.get_bytes(MEMORY))
    assert one.counts["refused"] == 2
    assert one.number == 0


def test_a_flood_of_rejected_messages_does_not_flood_the_log(known):
    worker, store = Worker(known, RHYTHM), Dictionary()
    sent = replace(block(known.groups["north.0"], 1, (5, 5, 5)), group="south.0", catalogue=1)
    with structlog.testing.capture_logs() as said:
        for _ in range(500):
            assert worker.samples(b"south.0", write_samples(sent), store) == []
    assert 0 < len(said) < 30
    assert len(worker.rejected()) == 500
    assert store.get_bytes(MEMORY) is None


@pytest.mark.parametrize("catalogue", [2, 2**62])
def test_samples_of_a_newer_catalogue_are_rejected_and_stop_no_worker(known, catalogue):
    worker, store = Worker(known, RHYTHM), Dictionary()
    sent = replace(block(known.groups["north.0"], 1, (5, 5, 5)), catalogue=catalogue)
    assert worker.samples(b"north.0", write_samples(sent), store) == []
    (letter,) = worker.rejected()
    said = f"version {catalogue} of the catalogue, this is version 1: bring the worker's catalogue"
    assert said in letter.reason


def test_a_message_whose_processing_raises_is_rejected_and_its_group_is_as_before(
    known, undisturbed, monkeypatch
):
    """In the middle of learning, between two commits, with what was learnt since the last."""
    worker, store, out = Worker(known, RHYTHM), Dictionary(), []
    learn, poison = Group.take, block(known.groups["north.0"], 999, (5, 5, 5))

    def take(one, sent, at=None):
        yield from learn(one, sent, at)
        if sent.number == poison.number:
            raise RuntimeError("in the middle")

    monkeypatch.setattr(Group, "take", take)
    with structlog.testing.capture_logs() as said:
        for k, message in enumerate(as_messages(day(known.groups["north.0"], seed=0))):
            out += run(worker, {"north.0": store}, message)
            assert worker.samples(b"north.0", write_samples(poison), store) == []
            (letter,) = worker.rejected()
            assert letter.reason == "unexpected RuntimeError: in the middle"
            if k % 4 == 3:
                worker.keep()
                store.commit()
    worker.keep()
    assert out == undisturbed["north.0"][0]
    found, alone = (
        replace(read_memory(one), counts={})
        for one in (store.get_bytes(MEMORY), undisturbed["north.0"][1])
    )
    assert write_memory(found) == write_memory(alone)
    assert len([one for one in said if "exc_info" in one]) == 1


def test_a_state_of_a_newer_catalogue_stops_the_worker_with_one_line(known):
    newer = catalogue(version=2)
    store = Dictionary()
    store.set_bytes(MEMORY, Group(newer.groups["north.0"], 2).to_bytes())
    kept = store.get_bytes(MEMORY)
    sent = block(known.groups["north.0"], 1, (5, 5, 5))
    with pytest.raises(FleetError, match=r"^group north\.0: .* version 2 .* this is version 1"):
        Worker(known, RHYTHM).samples(b"north.0", write_samples(sent), store)
    assert store.get_bytes(MEMORY) == kept


def damaged(packed, flips):
    """A state with bytes changed at random positions, cut, or of another program."""
    rng = np.random.default_rng(34)
    for _ in range(flips):
        found = bytearray(packed)
        at = rng.integers(len(packed) if rng.random() < 0.5 else 3_000)
        found[at] ^= rng.integers(1, 256)
        yield bytes(found)
    yield packed[: len(packed) // 2]
    yield packed + b"x"
    yield b""
    yield b"of another program"


@pytest.mark.parametrize("flips", [50, *soaked(150)])
def test_a_damaged_state_is_set_aside_and_its_group_starts_without_it(known, undisturbed, flips):
    """Flips at random positions: nothing is learnt from them, and the worker lives."""
    first, after = (block(known.groups["north.0"], n, (9, 9, 9), first=9 * n) for n in (1, 2))
    fresh = group(known.groups["north.0"])
    expected = feed(fresh, [after])
    kept = group(known.groups["north.0"])
    feed(kept, [first])
    worker, other = Worker(known, RHYTHM), Dictionary()
    right = set()  # states that were looked into: they are nearly always the same bytes
    with structlog.testing.capture_logs():
        for k, packed in enumerate(damaged(kept.to_bytes(), flips)):
            store = Dictionary()
            store.set_bytes(MEMORY, packed)
            assert worker.samples(b"north.0", write_samples(after), store) == expected
            (letter,) = worker.rejected()
            assert letter.key == b"north.0"
            assert letter.reason.startswith("state set aside, the group starts without it: group ")
            assert (letter.payload, letter.size) == (packed, len(packed))
            assert dict(letter.headers(None))["content"] == b"state"
            if k % 10 == 0:
                other_block = block(known.groups["north.1"], k // 10 + 1, (9, 9), first=9 * k)
                worker.samples(b"north.1", write_samples(other_block), other)
            worker.keep()
            if store.get_bytes(MEMORY) not in right:
                found = read_memory(store.get_bytes(MEMORY))
                assert found.counts["damaged"] == 1
                assert found.number == 2
                again = group(known.groups["north.0"])
                again.remember(store.get_bytes(MEMORY))
                assert again.identification.valves.lane("V0", "RLS").count == 9
                right.add(store.get_bytes(MEMORY))
    assert worker._log.count == k + 1


def test_a_state_too_large_for_a_dead_letter_is_cut(known):
    worker, store = Worker(known, RHYTHM, TopicsConfig(message_mb=0.1)), Dictionary()
    store.set_bytes(MEMORY, bytes(100_000))
    worker.samples(b"north.0", write_samples(block(known.groups["north.0"], 1, (5, 5, 5))), store)
    (letter,) = worker.rejected()
    assert letter.size == 100_000
    assert len(letter.payload) < 90_000


PACKED = Injected(
    *("packing", Step.PUBLICATION, LANES, worker_module, "write_results"),
    lambda one: np.isfinite(one.results.signals.values[one.results.valves == CULPRIT]).any(),
)
ELSEWHERE = {  # not of a worker
    *(Step.ALIGNMENT, Step.HISTORY, Step.CHECKPOINT, Step.RECORDING, Step.PUBLICATION),
}
OF_A_WORKER = [*(step for step in STEPS if step.step not in ELSEWHERE), PACKED]


@pytest.mark.parametrize("step", OF_A_WORKER, ids=lambda step: step.name)
def test_an_error_in_any_step_of_one_valve_costs_a_worker_nothing_else(step, monkeypatch):
    known = catalogue(valves=VALVES, per_group=VALVES)
    plan = known.groups["north.0"]
    blocks = [marked(plan, number) for number in range(1, 7)]
    undisturbed = learnt_by(Worker(known, RHYTHM), blocks)
    worker, store = Worker(known, RHYTHM), Dictionary()
    with structlog.testing.capture_logs() as said, monkeypatch.context() as patch:
        broken(patch, step)
        out = learnt_by(worker, blocks, store)
    others = [f"V{v}" for v in range(VALVES) if v != CULPRIT]
    assert newest(out, others) == newest(undisturbed, others)
    errors = [entry for entry in said if entry["event"] == "lane failed"]
    assert [str(entry["exc_info"]) for entry in errors] == ["injected"]
    name = f"V{CULPRIT}"
    shown = newest(out, [name])[name]
    assert [shown[estimator][0] for estimator in step.stops] == [int(Status.FAILED)] * len(
        step.stops
    )
    alarm = lane_alarm(out, name)
    assert (alarm.active, alarm.acked) == (True, False)
    assert f"{step.said}: RuntimeError: injected" in alarm.text
    reset = Command("2", "north.0", name, "reset", step.stops[0])
    out = worker.command(b"north.0", write_message(reset), store)
    (reply,) = [read_reply(message) for message in out if is_reply(message)]
    assert reply.done, reply.reason
    out += worker.samples(b"north.0", marked(plan, 7), store)
    assert worker.rejected() == []
    again = newest(out, [name])[name]
    assert again[step.stops[0]][1] == 20
    assert [again[estimator][0] for estimator in LANES].count(int(Status.FAILED)) == 0
    assert not lane_alarm(out, name).active


def test_an_approved_map_that_cannot_be_packed_costs_the_others_nothing(monkeypatch):
    known = catalogue(valves=VALVES, per_group=VALVES)
    plan = known.groups["north.0"]
    worker, store = Worker(known, RHYTHM), Dictionary()
    for number in range(1, 4):
        worker.samples(b"north.0", marked(plan, number), store)
    for v in (CULPRIT, CULPRIT + 1):
        command = Command(f"a{v}", "north.0", f"V{v}", "approve")
        out = worker.command(b"north.0", write_message(command), store)
        assert all(read_reply(m).done for m in out if is_reply(m))
    worker.keep()
    before = read_memory(store.get_bytes(MEMORY)).baselines
    whole, culprit = Baseline.to_bytes, before[f"V{CULPRIT}"]

    def raising(found):
        if whole(found) == culprit:
            raise RuntimeError("injected")
        return whole(found)

    with monkeypatch.context() as patch:
        patch.setattr(Baseline, "to_bytes", raising)
        worker.samples(b"north.0", marked(plan, 4), store)
        worker.keep()
    assert read_memory(store.get_bytes(MEMORY)).baselines == before
    out = worker.samples(b"north.0", marked(plan, 5), store)
    shown = newest(out, [f"V{CULPRIT}", f"V{CULPRIT + 1}"])
    statuses = {v: {one[0] for one in shown[v].values()} for v in shown}
    assert statuses[f"V{CULPRIT}"] == {int(Status.FAILED)}
    assert int(Status.FAILED) not in statuses[f"V{CULPRIT + 1}"]
    assert "checkpoint: RuntimeError: injected" in lane_alarm(out, f"V{CULPRIT}").text


def marked(plan, number):
    lengths = [20] * VALVES
    found = block(plan, number, lengths, seed=number, first=20 * number)
    segments = found.samples.segments
    found.samples.samples.T[segments.starts[CULPRIT] : segments.stops[CULPRIT]] = MARK
    return write_samples(found)


def learnt_by(worker, blocks, store=None):
    store, out = store or Dictionary(), []
    demand = Command("1", "north.0", f"V{CULPRIT}", "demand", "", (30.0, 100.0))
    worker.command(b"north.0", write_message(demand), store)
    for message in blocks:
        out += worker.samples(b"north.0", message, store)
        worker.keep()
        store.commit()
    return out


def newest(out, valves):
    """Status, number of samples and theta of each estimator, as they were published last."""
    found = {}
    for message in out:
        if is_reply(message):
            continue
        shown = read_results(message)
        for row, valve in enumerate(shown.results.valves.tolist()):
            if shown.valves[valve] in valves:
                found[shown.valves[valve]] = {
                    name: (int(r.status[row]), int(r.sample_count[row]), r.theta[row].tobytes())
                    for name, r in shown.results.estimators.items()
                }
    return found


def lane_alarm(out, valve):
    """The alarm LaneFailed of a valve, as it was published last."""
    found = None
    for message in out:
        if is_reply(message):
            continue
        shown = read_results(message)
        for row, number in enumerate(shown.results.valves.tolist()):
            if shown.valves[number] == valve:
                reports = shown.results.alarms.reports(row)
                found = next((r for r in reports if r.name == "LaneFailed"), found)
    return found
