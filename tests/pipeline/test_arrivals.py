"""An alignment's state is restored as it was, or not at all."""

import json
import zlib

import numpy as np
import pytest

from support.plant import as_changes, plant
from valvemap.model.estimator import StateMismatchError
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.kernels import waiting as slots


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
    waiting = under_way._waiting
    under_way._waiting = waiting._replace(**{name: hurt(getattr(waiting, name))})
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
