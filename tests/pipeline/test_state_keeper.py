"""States on disk, whatever the disk refuses: after a crash no sample is lost and no bit differs."""

import asyncio
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from support.plant import plant
from valvemap.clock import ManualClock
from valvemap.errors import StateFileLost, StorageError
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.edges import Part
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.kept_lanes import lane_to_bytes
from valvemap.pipeline.kept_together import KeptValves
from valvemap.pipeline.operator_ports import Command
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.valve_memory import ValveMemory
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.runtime.kept_position import POSITION
from valvemap.runtime.state_keeper import StateKeeper
from valvemap.vocabulary.edges import Edge

VALVES = 3
SAMPLES = 40  # of each valve
A_TURN = 4  # samples that come between two turns
SIGNALS = 6  # of a valve: U, p1, p2, Q, T and its running number


def valves():
    plans = [
        ValvePlan(f"V{m}", QualityGate(), {"RLS": RecursiveLeastSquares()}, "RLS")
        for m in range(VALVES)
    ]
    align = Alignment(AlignmentSettings(), (("T",),) * VALVES, (True,) * VALVES)
    return Identification(plans, align)


@cache
def stream():
    """What the source sends: all valves' samples, one after the other."""
    columns = [plant(SAMPLES, seed=m) for m in range(VALVES)]
    values = np.stack(
        [np.stack([s.U, s.p1, s.p2, s.Q, s.T, np.arange(SAMPLES)], axis=1) for s in columns],
        axis=1,
    )
    return DataChanges(
        item=np.tile(np.arange(SIGNALS * VALVES, dtype=np.int32), SAMPLES),
        value=values.ravel(),
        status=np.zeros(values.size, np.uint32),
        source_time=np.repeat(columns[0].t, SIGNALS * VALVES),
    )


@cache
def uninterrupted():
    known = valves()
    known.take(stream())
    return known.states.checkpoints()


class Source:
    """Sends uncommitted changes again, and nothing else."""

    def __init__(self):
        self.committed = 0

    def commit(self, mark):
        self.committed = mark

    def position(self, mark):
        return str(mark).encode()


class Disk:
    """Refuses the saves that it was given as False; takes all others whole."""

    def __init__(self, answers):
        self._answers = iter(answers)
        self.kept = {}

    def save(self, checkpoints):
        if not next(self._answers, True):
            raise StorageError("state.sqlite: disk full")
        self.kept.update({(one.valve, one.estimator): one for one in checkpoints})


async def crashes(answers, turns, valves_a_turn):
    """Learn with one turn of the keeper after every few samples.

    Yields what a crash leaves behind, source and disk, before the first turn and after each.
    """
    source, disk, clock, known = Source(), Disk(answers), ManualClock(), valves()
    keeper = StateKeeper(KeptValves(known), source, disk, clock, interval_s=1.0)
    yield source, disk
    for turn in range(turns):
        first, stop = (SIGNALS * VALVES * A_TURN * n for n in (turn, turn + 1))
        known.take(stream()[first:stop])
        keeper.mark = min(stop, len(stream()))
        clock.advance(valves_a_turn / VALVES)
        keeper.keep_in_turn(clock.monotonic())
        await keeper.settle()
        yield source, disk


async def learn_and_crash(answers, turns, valves_a_turn):
    *_, left = [left async for left in crashes(answers, turns, valves_a_turn)]
    return left


def after_a_restart(source, disk):
    kept = dict(disk.kept)
    position = kept.pop(POSITION, None)
    resumed = 0 if position is None else int(position.state)
    assert resumed == source.committed, "acknowledged and saved positions differ"
    return learnt_from(resumed, tuple(kept.values()))


@cache
def learnt_from(resumed, kept):
    """What valves know at the end; many crashes leave the same behind."""
    known = valves()
    known.restore(list(kept))
    known.take(stream()[resumed:])
    return known.states.checkpoints()


@pytest.mark.parametrize("valves_a_turn", [1, 2, VALVES])
async def test_a_refused_save_at_every_position_of_a_round_loses_no_sample_and_no_bit(
    valves_a_turn,
):
    turns, tried = SAMPLES // A_TURN, 0
    for refused in range(turns):
        answers = [turn != refused for turn in range(turns)]
        async for left in crashes(answers, turns, valves_a_turn):
            assert after_a_restart(*left) == uninterrupted(), (refused, tried)
            tried += 1
    assert tried == turns * (turns + 1)


@given(
    answers=st.lists(st.booleans(), max_size=SAMPLES // A_TURN),
    turns=st.integers(0, SAMPLES // A_TURN),
    valves_a_turn=st.integers(1, 2 * VALVES),
)
@example(answers=[False, True, True], turns=3, valves_a_turn=1)
def test_whatever_the_disk_refuses_a_crash_loses_no_sample_and_no_bit(
    answers, turns, valves_a_turn
):
    left = asyncio.run(learn_and_crash(answers, turns, valves_a_turn))
    assert after_a_restart(*left) == uninterrupted()


async def test_the_position_is_kept_as_soon_as_every_valve_is():
    source, disk = await learn_and_crash([True, False, True, True], 4, valves_a_turn=1)
    assert source.committed == SIGNALS * VALVES * A_TURN
    assert POSITION in disk.kept


async def test_valves_whose_samples_meet_are_saved_in_one_turn():
    """States of different samples would never meet again after a restart."""
    rls = {"RLS": RecursiveLeastSquares()}
    behind = {"V1": "Q", "V3": "Q"}
    plans = [
        ValvePlan(name, QualityGate(), rls, "RLS", meter=behind.get(name, ""))
        for name in ("V0", "V1", "V2", "V3")
    ]
    plans += [
        ValvePlan(f"V.{part}", QualityGate(), rls, "RLS", part=Part("V", "A", edge))
        for part, edge in (("LineA", None), ("PA", Edge.PA), ("AT", Edge.AT))
    ]
    align = Alignment(AlignmentSettings(), (("T",),) * len(plans), (True,) * len(plans))
    disk, clock, saved = Disk([]), ManualClock(), []
    states = KeptValves(Identification(plans, align))
    keeper = StateKeeper(states, Source(), disk, clock, interval_s=1.0)
    for _ in range(6):
        disk.kept.clear()
        clock.advance(1.0 / len(plans) + 1e-6)
        keeper.keep_in_turn(clock.monotonic())
        await keeper.settle()
        saved.append({valve for valve, _ in disk.kept})
    turns = [turn for turn in saved if turn]
    assert turns[:4] == [{"V0"}, {"V1", "V3"}, {"V2"}, {"V.LineA", "V.PA", "V.AT"}]


async def test_what_has_not_changed_is_packed_once_and_again_for_a_new_file():
    known, source, clock = valves(), Source(), ManualClock()
    disk = Disk([True, True, True, False, True, True])
    keeper = StateKeeper(KeptValves(known), source, disk, clock, interval_s=1.0)
    packed = []
    for turn in range(6):
        disk.kept.clear()
        if turn in (0, 2, 3):
            known.take(stream()[: SIGNALS * VALVES * (turn + 1)])
        keeper.mark = turn + 1
        clock.advance(1.0)
        keeper.keep_in_turn(clock.monotonic())
        await keeper.settle()
        packed.append(len({valve for valve, _ in disk.kept} - {POSITION[0]}))
        assert keeper.kept_at == clock.monotonic() or turn == 3
    assert packed == [VALVES, 0, VALVES, 0, VALVES, 0]  # the fourth was refused
    assert source.committed == 6
    keeper._begin_again(StateFileLost("removed"))
    disk.kept.clear()
    keeper.keep_in_turn(clock.monotonic())
    await keeper.settle()
    assert len({valve for valve, _ in disk.kept} - {POSITION[0]}) == VALVES


def test_an_alarm_that_begins_is_a_change_and_how_long_it_lasts_is_none():
    known, every = valves(), np.arange(VALVES)
    known.take(stream())
    before = known.version
    known.watch_service(1, 0.0, math.nan, 0.0)
    list(known.results.of(range(VALVES)))
    assert known.version == before
    newest = known.results.one(0).estimators["RLS"].t
    assert known.say_overdue(every, np.full(VALVES, newest + 10**10)) == every.tolist()
    silent = known.version
    assert silent != before
    assert known.say_overdue(every, np.full(VALVES, newest + 10**12)) == []
    assert known.version == silent
    fleet, _ = known.valves.at(0)
    fleet.watch(every, lambda rows: fleet.alarms.note_answers(rows, np.ones(len(rows))))
    assert known.version != silent  # its delay has begun


def test_states_that_are_packed_without_a_copy_have_the_bits_of_copies():
    known = valves()
    known.take(stream()[: -SIGNALS * VALVES - 2])  # some samples wait
    known.do(Command.of("set_forgetting_factor", "V1", "RLS", 0.99))
    fleet, _ = known.valves.at(0)
    for m in range(VALVES):
        copied, seen = fleet.state(m), fleet.view(m)
        for name, lane in copied.lanes.items():
            assert lane_to_bytes(lane, "key") == lane_to_bytes(seen.lanes[name], "key")
            assert (lane.lam, lane.t, lane.status) == (
                seen.lanes[name].lam,
                seen.lanes[name].t,
                seen.lanes[name].status,
            )
        arrivals = known._parts.arrivals
        assert _packed(copied, arrivals.of(m)) == _packed(seen, arrivals.view(m))


def _packed(state, arrivals):
    return ValveMemory.of(state, arrivals, dict.fromkeys(state.lanes, 0)).to_bytes("key")


def test_rejections_are_counted_by_valve_in_any_order():
    known, sent = valves(), stream()
    sent = replace(sent, value=sent.value.copy())
    sent.value[3 + SIGNALS :: SIGNALS * VALVES] = np.nan  # Q of V1
    known.take(sent)
    (found,) = known.results.of([2, 1])
    column = found.counters[:, found.counter_names.index("not_finite")]
    assert column.tolist() == [0, SAMPLES]
