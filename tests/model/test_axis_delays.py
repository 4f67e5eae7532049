"""A signal of an axis that is shown late by less than the signal check tries is learnt so."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.axis import GEOMETRY, SIGMA, errors, machine, played, samples
from valvemap.model.axis import AxisRegression
from valvemap.model.axis_basis import COMMON
from valvemap.model.axis_fit import DELAY_SIZE
from valvemap.model.axis_search import fitted, identify
from valvemap.model.axis_spool import with_play_near
from valvemap.model.kernels.axis_rows import COMMAND, PER_DELAY, PISTON
from valvemap.vocabulary.statuses import AxisStatus

PRESSURES = ("pA", "pB", "pS", "pT")


@pytest.fixture(scope="module")
def coarse():
    """An axis whose position has 0.5 mm of noise, its recording, and its play and spool."""
    axis = machine(1404, noise_mm=0.5)
    axis = axis.model_copy(update={"valve": axis.valve.model_copy(update={"damping": 0.8})})
    valve = axis.valve
    spool = {"play_percent": valve.play_percent, "spool_hz": valve.natural_frequency_hz}
    return axis, played(axis, 1404, seconds=150.0), AxisRegression(GEOMETRY, **spool)


def late(of, n, *names):
    return replace(of, **{name: np.roll(getattr(of, name), n) for name in names})


def delays(found):
    """Return the delays of the piston's signal and of U with their standard deviations, ms."""
    at = [COMMON + PISTON, COMMON + COMMAND]
    std = np.sqrt(np.diag(found.covariance)[at])
    return 1e3 * PER_DELAY * found.theta[at], 1e3 * PER_DELAY * std


def error(axis, block, found):
    return float(np.sqrt(np.mean(errors(axis, block, found)[0] ** 2))) / SIGMA


@pytest.mark.parametrize(
    ("names", "n", "ms"),
    [
        ((), 0, (0.0, 0.0)),
        (("x",), 1, (10.0, 0.0)),
        (("U",), 1, (0.0, 10.0)),
        (PRESSURES, 1, (-10.0, -10.0)),
    ],
)
def test_a_delay_is_learnt_within_its_standard_deviation(coarse, names, n, ms):
    axis, block, known = coarse
    _, found = fitted(known, late(samples(block), n, *names))
    learnt, std = delays(found)
    assert (np.abs(learnt - ms) < 2.5 * std + 0.08 * np.abs(ms)).all()  # of first order
    assert (std < 2.0).all()
    beta, of_beta = found.bulk_modulus
    assert abs(beta - axis.cylinder.bulk_modulus_GPa) < 2.5 * of_beta
    assert beta == pytest.approx(axis.cylinder.bulk_modulus_GPa, rel=0.03)
    assert error(axis, block, found) < 0.3


def test_a_late_command_is_no_play(coarse):
    """Without a delay, the play is found narrower by what the spool moves within it."""
    axis, block, known = coarse
    of = late(samples(block), 2, "U")
    narrow = replace(known, play_percent=0.5, spool_hz=np.inf)
    found = with_play_near(narrow, of, fitted(narrow, of)[1].theta)
    assert found.play_percent == pytest.approx(axis.valve.play_percent, abs=0.15)
    assert error(axis, block, fitted(found, of)[1]) < 0.25


def test_without_samples_a_delay_is_as_wide_as_its_prior():
    known = AxisRegression(GEOMETRY)
    few = samples(played(machine(1404), 1404, seconds=1.0))[:10]
    _, std = delays(fitted(known, few)[1])
    assert std == pytest.approx(1e3 * PER_DELAY * DELAY_SIZE)


@pytest.mark.soak
@pytest.mark.parametrize(("name", "n"), [("x", 1), ("U", 2)])
def test_late_signals_leave_the_bulk_modulus_in_its_interval(coarse, name, n):
    axis, block, _ = coarse
    result = identify(late(samples(block), n, name), GEOMETRY)
    assert result.status is AxisStatus.OK
    off, std = errors(axis, block, result.fit)
    assert np.mean(np.abs(off) <= 1.96 * std) >= 0.9
    beta, of_beta = result.fit.bulk_modulus
    assert abs(beta - axis.cylinder.bulk_modulus_GPa) < 2.5 * of_beta
