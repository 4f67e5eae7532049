"""An alignment's state is restored as it was, or not at all."""

import json
import zlib

import numpy as np
import pytest

from support.plant import START, as_changes, plant
from valvemap.model.estimator import StateMismatchError
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.kernels import waiting as slots
from valvemap.pipeline.timing import Timing, TimingSettings
from valvemap.pipeline.valve_timing import ValveTiming


def arrivals():
    return Arrivals(["Valvistor"], Alignment(AlignmentSettings(), optional=(("T",),)))


@pytest.fixture
def under_way():
    found = arrivals()
    found.take(as_changes(plant(20)))
    return found


def sealed(body):
    """A body under the checksum that belongs to it."""
    return zlib.crc32(body).to_bytes(4, "big") + body


def test_it_comes_back_to_the_bit(under_way):
    again = arrivals()
    again.resume(under_way.to_bytes())
    assert again.to_bytes() == under_way.to_bytes()
    later = as_changes(plant(40, first=20))
    ours, theirs = under_way.take(later), again.take(later)
    for name in ("t", "U", "p1", "p2", "Q", "T"):
        np.testing.assert_array_equal(getattr(ours.samples, name), getattr(theirs.samples, name))


@pytest.mark.parametrize(
    "head",
    [
        b"",
        b"no json",
        b"[1]",
        b"{}",
        b"[null, []]",
        b"[1e400, []]",
        b'["x", [[0, 1]]]',
        b"[0, [[0]]]",
        b"[" * 100_000,
        b"\xff\xfe",
    ],
)
def test_a_head_that_is_none_is_refused_though_its_checksum_is_right(under_way, head):
    before = under_way.to_bytes()
    with pytest.raises(StateMismatchError):
        under_way.resume(sealed(head + b"\n" + b"rest"))
    assert under_way.to_bytes() == before


@pytest.mark.parametrize(
    ("name", "hurt"),
    [
        ("order", lambda array: np.where(np.arange(array.shape[1]) == slots.GIVEN_UP, -1, array)),
        ("slots", lambda array: array[:, :, :-1]),
        ("values", lambda array: array.astype(np.float32)),
        ("counters", lambda array: array - 1),
        ("lost", lambda array: array[:0]),
    ],
)
def test_arrays_that_cannot_wait_are_refused(under_way, name, hurt):
    waiting = under_way.buffers.waiting
    under_way.buffers.waiting = waiting._replace(**{name: hurt(getattr(waiting, name))})
    with pytest.raises(StateMismatchError):
        arrivals().resume(under_way.to_bytes())


def test_its_head_is_json(under_way):
    size, special = json.loads(under_way.to_bytes()[4:].partition(b"\n")[0])
    assert size > 0
    assert special == []


def test_states_of_valves_with_and_without_a_temperature_have_the_keys_of_0_1():
    both = Alignment(AlignmentSettings(), optional=(("T",), ()))
    packed = Arrivals(["V1", "V2"], both).to_bytes()
    assert b"f1313d23fda406722b07f7b25959b457aad304bd7fe717da49e79cde322e4d72" in packed.replace(
        b"\0", b""
    )


VALVES, CULPRIT, STEP_NS, SKEW_NS = 3, 1, 20_000_000, 2_000_000


def batches(staggered, count=30, n=25):
    """Changes of some valves; ``staggered``: each signal is stamped after the one before."""
    for number in range(count):
        parts = []
        for v in range(VALVES):
            samples = plant(n, seed=50 * v + number)
            t = START + (number * n + np.arange(n)) * STEP_NS
            values = [samples.U, samples.p1, samples.p2, samples.Q, samples.T]
            skew = np.arange(len(values)) * (SKEW_NS if staggered else 0)
            parts.append(
                DataChanges(
                    item=np.tile(np.arange(5, dtype=np.int32) + np.int32(6 * v), n),
                    value=np.stack(values, axis=1).ravel(),
                    status=np.zeros(5 * n, np.uint32),
                    source_time=(t[:, None] + skew).ravel(),
                )
            )
        yield DataChanges.concatenate(parts)


def of_three():
    timing = Timing(TimingSettings(), (("T",),) * VALVES)
    alignment = Alignment(AlignmentSettings(), (("T",),) * VALVES)
    return Arrivals([f"V{v}" for v in range(VALVES)], alignment, timing)


def bits(found, valve):
    return [
        b"".join(column.tobytes() for column in vars(samples[valve]).values())
        for samples in found
        if valve in samples
    ]


@pytest.mark.parametrize(
    ("owner", "staggered", "at"),
    [
        (Alignment, False, 0),
        (Alignment, False, 20),
        (Alignment, True, 20),
        (ValveTiming, False, 0),
        (ValveTiming, True, 0),
        (ValveTiming, True, 5),
        (ValveTiming, True, 20),
    ],
)
def test_an_error_at_one_valve_costs_the_others_no_bit_and_it_starts_again(
    owner, staggered, at, monkeypatch
):
    undisturbed, one = of_three(), of_three()
    expected = [undisturbed.take(some) for some in batches(staggered)]
    whole, culprit = owner.take, one.timing.valves[CULPRIT]

    def raising(self, *args, **kwargs):
        found = whole(self, *args, **kwargs)  # what it has written is to be undone
        if self is culprit or (owner is Alignment and CULPRIT in args[1].item // 6):
            raise RuntimeError("injected")
        return found

    found = []
    for number, some in enumerate(batches(staggered)):
        with monkeypatch.context() as patch:
            if number == at:
                patch.setattr(owner, "take", raising)
            found.append(one.take(some))
        assert one.failed.tolist() == [False, number >= at, False]
    ((valve, error),) = one.buffers.new_failures()
    assert (valve, str(error)) == (CULPRIT, "injected")
    for v in (0, 2):
        assert bits(found, v) == bits(expected, v)
    assert not any(CULPRIT in some for some in found[at:])
    assert not one.waits()[CULPRIT]
    assert len(one.wait_no_longer(np.array([CULPRIT]))) == 0
    one.start_again(CULPRIT)
    assert CULPRIT in [one.take(some) for some in batches(staggered, count=60)][-1]
    assert one.buffers.new_failures() == []


@pytest.mark.parametrize("call", ["flush", "begin_anew"])
def test_an_error_while_one_valve_is_flushed_or_begins_anew_is_isolated_too(call, monkeypatch):
    one, every, whole = of_three(), np.arange(VALVES), getattr(Alignment, call)
    for some in batches(staggered=False, count=4):
        one.take(some)

    def raising(self, waiting, valves):
        found = whole(self, waiting, valves)
        if CULPRIT in valves:
            raise RuntimeError("injected")
        return found

    with monkeypatch.context() as patch:
        patch.setattr(Alignment, call, raising)
        if call == "flush":
            one.wait_no_longer(every)
        else:
            one.begin_source_anew(every, started=1)
    assert one.failed.tolist() == [False, True, False]
    later = list(batches(staggered=False, count=6))[-1]
    assert list(one.take(later)) == [0, 2]
    one.begin_source_anew(every, started=2)
    assert not one.failed.any()
