"""Columns packed without loss: the same bits, whatever they are, and small where they can be."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvemap.storage.packing import (
    MAGIC,
    others_of,
    pack_doubles,
    pack_integers,
    unpack_doubles,
    unpack_integers,
)

RNG = np.random.default_rng(3)
N = 4_096
NOISE = RNG.normal(200.0, 0.05, N)
STEPS = np.rint(NOISE / 0.01) * 0.01
SIGNALLING = np.array([0x7FF0_0000_0000_0001, 0x7FF8_0000_DEAD_BEEF, -1], np.int64)
BITS = st.lists(st.integers(-(2**63), 2**63 - 1), max_size=40)


def spoilt(values):
    """NaN with payloads, infinities and −0.0 among values."""
    values = values.copy()
    values[5:8] = SIGNALLING.view(np.float64)
    values[20:23] = -0.0, np.inf, -np.inf
    return values


COLUMNS = {
    "steps": (STEPS, 1.3),
    "decimals": (np.round(NOISE, 2), 1.3),
    "spoilt steps": (spoilt(STEPS), 1.6),
    "singles": (STEPS.astype(np.float32).astype(float), 1.3),
    "noise": (NOISE, 6.5),
    "spoilt noise": (spoilt(NOISE), 6.6),
    "constant": (np.full(N, 42.1234567), 0.1),
    "missing": (np.full(N, np.nan), 0.05),
    "integers": (RNG.integers(0, 5, N).astype(float), 0.6),
    "tiny": (np.full(3, 5e-324), 99.0),
    "none": (np.empty(0), 0.0),
}


@pytest.mark.parametrize(("values", "most"), COLUMNS.values(), ids=COLUMNS)
def test_doubles_are_the_same_bits_and_small(values, most):
    packed = pack_doubles(values)
    assert unpack_doubles(packed).tobytes() == values.tobytes()
    assert len(packed) <= most * max(len(values), 1) + 60


@given(bits=BITS, other=BITS)
def test_any_bits(bits, other):
    values = np.array(bits, np.int64).view(np.float64)
    others = {"a": np.resize(np.array([*other, 7], np.int64).view(np.float64), len(values))}
    others["b"] = np.ones(len(values))
    packed = pack_doubles(values, others)
    assert unpack_doubles(packed, others.get).tobytes() == values.tobytes()
    assert (unpack_integers(pack_integers(np.array(bits, np.int64))) == bits).all()


def test_times_cost_nearly_nothing_where_they_are_regular_and_little_where_they_jitter():
    t = 1_700_000_000_123_456_700 + np.arange(N) * 100_000_000
    assert len(pack_integers(t)) < 60
    jitter = t + 100 * RNG.integers(-500, 500, N)
    packed = pack_integers(jitter)
    assert (unpack_integers(packed) == jitter).all()
    assert len(packed) < 1.8 * N


def test_a_column_that_follows_from_others_costs_nothing():
    p1, p2 = STEPS, np.roll(STEPS, 7) - 60.0
    others = {"U": NOISE, "p1": p1, "p2": p2}
    packed = pack_doubles(p1 - p2, others)
    assert others_of(packed) == ("p1", "p2")
    assert len(packed) < 60
    assert unpack_doubles(packed, others.get).tobytes() == (p1 - p2).tobytes()


def test_a_residual_costs_what_the_measurement_does():
    predicted = NOISE + RNG.normal(size=N)
    residual = spoilt(STEPS - predicted)
    packed = pack_doubles(residual, {"PredictedFlow": predicted})
    assert others_of(packed) == ("PredictedFlow",)
    assert len(packed) < 2.0 * N
    found = unpack_doubles(packed, {"PredictedFlow": predicted}.get)
    assert found.tobytes() == residual.tobytes()
    with pytest.raises(ValueError, match="are missing"):
        unpack_doubles(packed)


@pytest.mark.parametrize("cut", [0, 3, 8, 12, 20, -1])
def test_what_is_cut_short_is_refused(cut):
    for packed, unpack in (
        (pack_doubles(STEPS[:200]), unpack_doubles),
        (pack_integers(np.arange(200)), unpack_integers),
    ):
        with pytest.raises(ValueError, match=r"cut|packed|shorter"):
            unpack(packed[:cut])
        with pytest.raises(ValueError, match="longer"):
            unpack(packed + b"\0")
    with pytest.raises(ValueError, match="longer than any block"):
        unpack_doubles(MAGIC + b"\0" + b"\xff\xff\xff\x7f")
