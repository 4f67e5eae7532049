"""Dry friction from the balance of forces: found beside a load, a mass and what is not measured."""

import numpy as np
import pytest

from valvemap.model.axis import AxisGeometry, AxisSamples
from valvemap.model.axis_force import ForceReference, ForceState

GEOMETRY = AxisGeometry(63, 45, 800, 1.2, 1.2)
PERIOD_S = 0.01
DRY_N, MASS_kg, VISCOUS = 400.0, 800.0, 1_500.0


def moved(seconds, dry=DRY_N, mass=MASS_kg, seed=1):
    """A piston that turns now and then, under a load of several kN; samples and speed, mm/s."""
    rng = np.random.default_rng(seed)
    t = PERIOD_S * np.arange(round(seconds / PERIOD_S))
    phases = rng.uniform(0.0, 2.0 * np.pi, 6)
    f = np.array([0.31, 0.47, 0.9, 1.3, 2.1, 3.3])
    size = np.array([60.0, 50.0, 25.0, 12.0, 4.0, 2.0])
    arguments = 2.0 * np.pi * np.outer(t, f) + phases
    v, a = np.sin(arguments) @ size, np.cos(arguments) @ (2.0 * np.pi * f * size)
    load = 5_000.0 * np.sin(0.9 * t) + 1_000.0 * np.sign(np.sin(0.7 * t + phases[0]))
    force = 1e-3 * mass * a + load + dry * np.tanh(v / 2.0) + 1e-3 * VISCOUS * v
    pB = 50.0 + 5.0 * np.sin(0.4 * t)
    pA = (0.1 * force + GEOMETRY.A_B * pB) / GEOMETRY.A_A + 0.02 * rng.standard_normal(len(t))
    samples = AxisSamples.of((1e9 * t).astype(np.int64) + 1, pA=pA, pB=pB)
    return samples, v + 0.3 * rng.standard_normal(len(t))


@pytest.fixture(scope="module")
def reference():
    return ForceReference.of(GEOMETRY, PERIOD_S, *moved(200.0))


def evidence(reference, *work):
    state = reference.update(ForceState.initial(), *work)
    return reference.weighed(state, 0.0, 1.0)


def test_friction_and_mass_are_the_axis_own(reference):
    D, _, mass = reference.theta
    assert 0.6 * DRY_N < D < 1.1 * DRY_N  # the course assumes half more near a standstill
    assert mass == pytest.approx(MASS_kg, rel=0.1)


def test_more_and_less_friction_have_evidence_and_nothing_else_has(reference):
    more = evidence(reference, *moved(60.0, dry=2.0 * DRY_N, seed=2))
    assert more.factor > 20.0
    assert more.size == pytest.approx(1.0, abs=0.3)
    less = evidence(reference, *moved(60.0, dry=0.4 * DRY_N, seed=2))
    assert less.factor > 5.0
    assert less.size < -0.3
    assert evidence(reference, *moved(60.0, seed=2)).factor < 0.0
    assert evidence(reference, *moved(60.0, mass=2.0 * MASS_kg, seed=2)).factor < 3.0


def test_any_division_of_the_samples_gives_the_same_bits(reference):
    samples, speed = moved(20.0, seed=3)
    speed[700:720] = np.nan  # an interval that is left out
    whole = reference.update(ForceState.initial(), samples, speed)
    parts = ForceState.initial()
    for start in range(0, len(speed), 37):
        part = slice(start, start + 37)
        parts = reference.update(parts, samples[part], speed[part])
    for name, array in vars(whole).items():
        assert np.array_equal(array, getattr(parts, name)), name
    assert 0 < whole.squares[2] < len(speed) / 4 - 20


def test_too_few_rows_and_no_friction_have_no_reference():
    assert ForceReference.of(GEOMETRY, PERIOD_S, *moved(20.0)) is None
    samples, _ = moved(60.0)
    assert ForceReference.of(GEOMETRY, PERIOD_S, samples, np.zeros(len(samples))) is None


@pytest.mark.parametrize("absurd", [np.nan, np.inf, 1e308])
def test_absurd_samples_have_no_evidence_and_no_exception(reference, absurd):
    samples, speed = moved(5.0)
    with np.errstate(all="ignore"):
        found = evidence(reference, samples, np.full_like(speed, absurd))
    assert not found.factor > 1.0
