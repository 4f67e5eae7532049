"""Signs of an operator: their rhythm is learnt, whatever it is, and a late one is seen."""

import math

import numpy as np
import pytest

from valvemap.pipeline.operator_signs import OperatorSigns


def heard(times):
    signs = OperatorSigns()
    for t in times:
        signs = signs.after(float(t))
    return signs


def test_before_a_rhythm_is_known_no_sign_is_late():
    assert OperatorSigns().late_s(5.0) == 0.0
    assert heard([0.0, 0.5]).late_s(5.0) == 0.0


@pytest.mark.parametrize("period", [0.05, 0.1, 0.4, 0.9])
def test_late_counts_from_the_sign_that_should_have_come(period):
    signs = heard(np.arange(30) * period)
    assert signs.late_s(29.9 * period) == 0.0
    assert signs.late_s(30.0 * period + 0.15) == pytest.approx(0.15)


def test_one_hiccup_of_the_network_does_not_become_the_rhythm():
    times = np.arange(30) * 0.1
    times[25] += 0.09
    assert heard(times).period_s == pytest.approx(0.1)


def test_two_clients_of_one_operator_are_not_late_between_their_signs():
    pairs = np.ravel([(t, t + 0.001) for t in np.arange(20) * 0.4])
    assert heard(pairs).late_s(pairs[-1] + 0.39) == 0.0


def test_the_rhythm_is_learnt_anew_and_memory_is_bounded():
    signs = heard([*np.arange(20) * 0.1, *(2.0 + np.arange(1, 10) * 0.5)])
    assert signs.period_s == pytest.approx(0.5)
    assert len(signs.heard) < 12
    assert math.isfinite(signs.period_s)


def test_a_service_that_was_held_up_does_not_blame_the_operator():
    signs = heard(np.arange(30) * 0.1)
    for t in np.arange(2.9, 3.0, 0.02):
        signs = signs.at(float(t))
    assert signs.at(3.5).late_s(3.5) < 0.1
    awake = signs
    for t in np.arange(3.0, 3.52, 0.02):
        awake = awake.at(float(t))
    assert awake.late_s(3.5) == pytest.approx(0.5)
