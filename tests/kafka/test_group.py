"""A group comes to the same bits whoever learns it, and however often it is handed over."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pyarrow")

from support.fleet import ESTIMATORS, block, catalogue, day, feed, group
from support.plant import START
from valvemap.app.build import build_identification
from valvemap.config.estimators import AutoConfig, RlsConfig
from valvemap.errors import BlockError, FleetError
from valvemap.kafka.commands import (
    Command,
    Reply,
    carry_out,
    read_command,
    read_reply,
    write_message,
)
from valvemap.kafka.memory import MAGIC, Memory, read_memory, sealed, write_memory
from valvemap.kafka.result_blocks import read_results
from valvemap.pipeline.valve_columns import Columns


@pytest.fixture(scope="module")
def plan():
    return catalogue().groups["north.0"]


@pytest.fixture(scope="module")
def messages(plan):
    return day(plan)


@pytest.fixture(scope="module")
def undisturbed(plan, messages):
    one = group(plan)
    return feed(one, messages), one.to_bytes()


def test_valves_are_dealt_out_to_groups_in_their_order():
    found = catalogue(valves=7).groups
    assert {name: [p.name for p in one.plans] for name, one in found.items()} == {
        "north.0": ["V0", "V1", "V2"],
        "north.1": ["V3", "V4", "V5"],
        "north.2": ["V6"],
    }


def test_handed_over_after_every_message_it_comes_to_the_same_bits(plan, messages, undisturbed):
    out, memory = [], None
    for message in messages:
        one = group(plan)
        if memory is not None:
            assert one.remember(memory) == []
        out += feed(one, [message])
        memory = one.to_bytes()
    assert out == undisturbed[0]
    assert memory == undisturbed[1]


def test_what_is_learnt_is_what_one_machine_learns(plan, messages):
    fleet, alone = group(plan), build_identification(catalogue().sites["north"])
    for message in messages:
        feed(fleet, [message])
        if isinstance(message, Command):
            carry_out(message, alone)
            continue
        for valve, samples in message.samples.items():
            for part in (samples[:3], samples[3:]):  # cut otherwise
                alone.take_samples(valve, part)
    for valve in range(3):
        ours, theirs = fleet.identification.valves.state(valve), alone.valves.state(valve)
        for name, lane in ours.lanes.items():
            key = "any"
            assert lane.state.to_bytes(key) == theirs.lanes[name].state.to_bytes(key)
            assert repr(lane) == repr(theirs.lanes[name])
        assert ours.demand_Q == theirs.demand_Q or np.isnan(ours.demand_Q)


def test_a_block_that_comes_twice_is_left_aside_and_one_that_never_came_is_counted(plan):
    one = group(plan)
    first, second = block(plan, 1, (20, 20, 20)), block(plan, 2, (20, 20, 20), first=20)
    feed(one, [first, second])
    known = one.to_bytes()
    assert feed(one, [first, second]) == []
    assert one.counts["repeated"] == 2
    one.counts["repeated"] = 0
    assert one.to_bytes() == known
    feed(one, [block(plan, 6, (20, 0, 0), first=100)])
    assert one.counts["missing"] == 3


def test_numbers_that_begin_anew_are_known_by_their_times(plan):
    one = group(plan)
    feed(one, [block(plan, 40, (20, 20, 20))])
    feed(one, [block(plan, 1, (20, 20, 20), first=20)])
    assert one.number == 1
    assert {name: n for name, n in one.counts.items() if n} == {"begun_anew": 1}
    assert one.identification.valves.state(0).lanes["RLS"].count == 40


def test_results_come_in_the_rhythm_of_the_samples_and_tables_more_seldom(plan):
    one = group(plan)
    blocks = [block(plan, k + 1, (10, 10, 10), first=10 * k) for k in range(30)]  # 0.1 s each
    out = [read_results(packed) for packed in feed(one, blocks)]
    assert [found.number for found in out] == list(range(1, 31, 2))
    with_tables = [found.number for found in out if found.results.inverse.map_U[0].size]
    assert with_tables == [1, 11, 21]
    assert all(found.results.estimators["RLS"].survey[2] is not None for found in out[::5])
    assert out[-1].results.signals.t.tolist() == [START + 289 * 10_000_000] * 3


def test_a_command_is_answered_when_it_is_done_or_why_not(plan):
    one = group(plan)
    feed(one, [block(plan, 1, (60, 60, 60))])
    *results, reply = feed(one, [Command("a", "north.0", "V1", "demand", "", (60.0, 100.0))])
    assert read_reply(reply) == Reply("a", "north.0", 1, done=True)
    assert read_results(results[0]).valves == ("V1",)
    assert np.isfinite(read_results(results[0]).results.inverse.required_U[0])
    for asked, reason in (
        (Command("b", "north.0", "V9", "reset", "RLS"), "group north.0 has no valve 'V9'"),
        (Command("c", "north.0", "V1", "reset", "KF"), "V1 has no estimator 'KF'"),
        (Command("d", "north.0", "V1", "melt"), "melt with 0 values: there are reset (0)"),
        (Command("e", "north.0", "V1", "demand"), "demand with 0 values"),
        (
            Command("f", "north.0", "V1", "set_forgetting_factor", "RLS", (2.0,)),
            "V1.RLS: forgetting factor 2.0: allowed is 0.8333 <= lam <= 1",
        ),
        (Command("g", "north.0", "V1", "roll_back"), "V1 has no baseline"),
        (Command("h", "north.0", "V1", "acknowledge", "Rust", (1,)), "no alarm 'Rust'"),
        (
            Command("i", "north.0", "V1", "acknowledge", "Changed", (1,)),
            "V1.Changed: there is nothing to acknowledge",
        ),
        (Command("j", "north.0", "V1", "compare", "RLS"), "V1 has no baseline"),
    ):
        before = without_replies(one)
        (reply,) = feed(one, [asked])
        said = read_reply(reply)
        assert not said.done
        assert said.reason.startswith(reason)
        assert without_replies(one) == before


def without_replies(one):
    return write_memory(replace(read_memory(one.to_bytes()), replies=()))


def test_a_command_that_comes_twice_is_done_once_by_whoever_learns_the_group(plan):
    """A reset, samples, and the same reset again; then another that asks for it anew."""
    reset = Command("once", "north.0", "V1", "reset", "RLS")
    one = group(plan)
    *_, reply = feed(one, [block(plan, 1, (60, 60, 60)), reset])
    feed(one, [block(plan, 2, (30, 30, 30), seed=2, first=60)])
    other = group(plan)
    other.remember(one.to_bytes())
    before = other.to_bytes()
    assert feed(other, [reset]) == [reply]
    assert other.to_bytes() == before
    assert other.identification.valves.lane("V1", "RLS").t > 0
    feed(other, [replace(reset, id="again")])
    assert other.identification.valves.lane("V1", "RLS").t == 0
    refused = Command("r", "north.0", "V1", "roll_back")
    (reply,) = feed(other, [refused])
    feed(other, [Command("a", "north.0", "V0", "approve"), replace(refused, valve="V0")])
    assert feed(other, [refused]) == [reply]


def test_replies_are_kept_of_the_last_commands_alone(plan):
    one = group(plan)
    for k in range(130):
        feed(one, [Command(str(k), "north.0", "V1", "freeze", "RLS")])
    assert len(read_memory(one.to_bytes()).replies) == 100


def test_questions_are_answered_in_numbers_and_leave_no_trace(plan):
    one = group(plan)
    feed(one, [block(plan, 1, (60, 60, 60))])
    before = one.to_bytes()
    (reply,) = feed(one, [Command("q", "north.0", "V1", "predict", "RLS", (50.0, 80.0, None))])
    expected = one.identification.predict("V1", "RLS", 50.0, 80.0, np.nan)
    assert read_reply(reply).values == expected
    (reply,) = feed(one, [Command("q", "north.0", "V1", "invert", "", (1e3, 80.0, 40.0))])
    U, _, _, status = read_reply(reply).values
    assert one.identification.invert("V1", 1e3, 80.0, 40.0).U[0] == U or U is None
    assert status is not None
    assert one.to_bytes() == before


def test_commands_travel_as_they_are_and_others_are_refused():
    sent = Command("7", "north.0", "V1", "demand", "", (60.0, None))
    assert read_command(write_message(sent)) == sent
    for message, said in (
        (b"\xff", "not a command: not JSON"),
        (b"[]", "not a command"),
        (write_message(Reply("1", "g", 1, done=True)), "not a command"),
        (write_message(sent).replace(b'"version": 1', b'"version": 2'), "of version 2"),
        (b'{"valvemap": "command", "version": 1, "valve": 3}', "valve cannot be so"),
        (b'{"valvemap": "command", "version": 1, "values": ["x"]}', "values must be numbers"),
        (b'{"valvemap": "command", "version": 1, "more": 1}', "more cannot be so"),
    ):
        with pytest.raises(BlockError, match=said):
            read_command(message)


def test_blocks_of_others_teach_nothing(plan):
    one = group(plan)
    before = one.to_bytes()
    other = catalogue(valves=7).groups["north.1"]
    with pytest.raises(BlockError, match=r"a block of group north\.1 under the key north\.0"):
        feed(one, [block(other, 1, (5, 5, 5))])
    with pytest.raises(BlockError, match=r"group north\.0 has no valve 'X'"):
        feed(one, [replace(block(plan, 1, (5, 5, 5)), valves=("V0", "X", "V2"))])
    assert one.to_bytes() == before


def test_the_order_of_the_valves_in_a_block_does_not_matter(plan):
    one, other = group(plan), group(plan)
    sent = block(plan, 1, (20, 7, 13))
    feed(one, [sent])
    turned = replace(sent, valves=("V2", "V0", "V1"))
    names = {"V2": 0, "V0": 1, "V1": 2}
    feed(other, [turned])
    for name, k in names.items():
        ours = other.identification.valves.lane(name, "RLS").state.to_bytes("")
        assert ours == one.identification.valves.lane(f"V{k}", "RLS").state.to_bytes("")


def test_a_new_catalogue_keeps_what_still_fits_and_says_what_does_not(undisturbed, plan):
    other = catalogue(valves=2, version=2, estimators=(*ESTIMATORS[:2], AutoConfig()))
    changed = group(other.groups["north.0"], version=2)
    assert changed.remember(undisturbed[1]) == ["V0: Auto", "V1: Auto"]
    before = group(plan)
    before.remember(undisturbed[1])
    for name in ("RLS", "RML"):
        kept = changed.identification.valves.lane("V1", name)
        assert repr(kept) == repr(before.identification.valves.lane("V1", name))
    assert changed.identification.valves.lane("V1", "Auto").count == 0


def test_a_memory_of_another_configuration_is_refused_in_one_line(undisturbed, plan):
    newer = group(plan, version=3)
    newer.remember(undisturbed[1])
    for one, packed, said in (
        (group(plan), newer.to_bytes(), "version 3 of the catalogue, this is version 1"),
        (
            group(catalogue(estimators=(RlsConfig(),)).groups["north.0"]),
            undisturbed[1],
            "configured otherwise under the same version 1 of the catalogue",
        ),
        (group(plan), b"", "not a group's memory"),
        (group(plan), undisturbed[1][:-9], "a group's memory is damaged"),
        (group(plan), undisturbed[1] + b"x", "a group's memory is damaged"),
        (group(plan), MAGIC + b"\n" + b"\x00" * 8, "a group's memory is damaged"),
        (group(plan), sealed(b"\x00" * 8), "a group's memory is damaged"),
        (
            group(plan),
            sealed(undisturbed[1][len(sealed()) :].replace(b'"format": 3', b'"format": 7')),
            "a memory of format 7, this one knows up to 3",
        ),
    ):
        with pytest.raises(FleetError, match=r"^group north\.0: ") as refused:
            one.remember(packed)
        assert said in str(refused.value)
        assert len(str(refused.value).splitlines()) == 1


def test_columns_of_counts_come_back_whether_they_are_alike_or_not():
    rng = np.random.default_rng(5)
    some = rng.integers(0, 256, (3, 40, 9), np.uint8)
    other = some.copy()
    other[1, 7] += 1
    stamps = np.arange(3 * 40 * 9, dtype=np.uint32).reshape(some.shape) + 2**31
    arrays = {"a": some, "b": other, "c": other[::-1], "none": np.zeros((3, 0), np.uint8)}
    kept = [
        Columns("one", ("V0", "V1", "V2"), {**arrays, "t": np.arange(3), "n": stamps}),
        Columns(
            "two", ("V1", "V2", "V0"), {"a": np.roll(some, 1), "n": stamps + 1, "zeros": 0 * some}
        ),
    ]
    packed = write_memory(Memory(1, 2, {}, {}, kept, {"V1": b"x"}))
    assert len(packed) < 4 * some.nbytes + 2 * stamps.nbytes
    found = read_memory(packed)
    assert found.baselines == {"V1": b"x"}
    for ours, columns in zip(found.columns, kept, strict=True):
        assert ours.valves == columns.valves
        for name, array in columns.arrays.items():
            assert ours.arrays[name].dtype == array.dtype
            np.testing.assert_array_equal(ours.arrays[name], array)


def test_a_memory_that_compressed_nothing_is_read_and_what_is_kept_otherwise_now_begins_anew(
    undisturbed, plan
):
    kept = read_memory(undisturbed[1])
    lanes, others = kept.columns[-1], kept.columns[:-1]
    wider = {name: array.astype(np.float64) for name, array in lanes.arrays.items()}
    columns = [*others, replace(lanes, arrays=wider)]
    head = {
        "format": 1,
        "catalogue": kept.catalogue,
        "number": kept.number,
        "due": kept.due,
        "counts": kept.counts,
        "baselines": [],
        "replies": [],
        "columns": [
            [one.key, one.valves, [[n, a.dtype.str, a.shape] for n, a in one.arrays.items()]]
            for one in columns
        ],
    }
    said = json.dumps(head).encode()
    body = b"".join(a.tobytes() for one in columns for a in one.arrays.values())
    one = group(plan)
    afresh = one.remember(MAGIC + b"\n" + struct.pack("<Q", len(said)) + said + body)
    estimator = lanes.key.partition(" ")[0]
    assert afresh == [f"{valve}: {estimator}" for valve in lanes.valves]
    before = group(plan)
    before.remember(undisturbed[1])
    assert repr(one.identification.valves.lane("V1", "RLS")) == repr(
        before.identification.valves.lane("V1", "RLS")
    )
    assert one.identification.valves.lane("V1", estimator).count == 0


def test_damage_of_a_memorys_head_is_refused_or_read_and_never_more(undisturbed):
    rng = np.random.default_rng(3)
    assert write_memory(read_memory(undisturbed[1])) == undisturbed[1]
    refused = 0
    for _ in range(300):
        damaged = bytearray(undisturbed[1][len(sealed()) :])
        damaged[rng.integers(4000)] = rng.integers(256)
        try:
            read_memory(sealed(damaged))
        except FleetError:
            refused += 1
    assert refused > 50
