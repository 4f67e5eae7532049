"""What counts as a change of a valve's dynamics, and that its reference outlives a restart."""

import math
from dataclasses import replace

import numpy as np
import pytest

from support.plant import as_changes, plant
from valvemap.model.dynamics import Dynamics, NotFitted, Quantity
from valvemap.model.estimator import StateMismatchError
from valvemap.model.spool_model import Hold
from valvemap.pipeline.dynamics_reference import KEY, DynamicsReferences
from valvemap.pipeline.operator_ports import Command
from valvemap.vocabulary.dynamics import DYNAMIC_QUANTITIES, DynamicsStatus
from valvemap.vocabulary.findings import FindingCode
from valvemap.vocabulary.statuses import Status

VALVE = "Valvistor"


def dynamics(f, std=0.1):
    """Dynamics with this natural frequency, Hz."""
    told = Quantity(f, std, Status.OK)
    return Dynamics(
        told, Quantity(0.7, 0.01, Status.OK), Quantity(), Quantity(), Quantity(),
        Quantity(0.02, 0.001, Status.OK), 50.0, 0.1, Hold.CONSTANT, np.zeros(3), (0.0, 1.0, 1.0),
    )  # fmt: skip


def test_half_the_frequency_is_a_finding_and_its_noise_is_not():
    references = DynamicsReferences()
    assert not references.judge(0, dynamics(20.0), 1).findings
    for f in np.random.default_rng(1).normal(20.0, 0.1, 500):
        assert not references.judge(0, dynamics(f), 2).findings
    (finding,) = references.judge(0, dynamics(10.0), 3).findings
    assert finding.code is FindingCode.DYNAMICS_CHANGE
    assert finding.probability > 0.99
    assert "from 20 to 10 ±" in finding.sentence
    assert not references.judge(0, dynamics(20.1), 4).findings


def test_an_uncertain_frequency_is_no_finding():
    references = DynamicsReferences()
    references.judge(0, dynamics(20.0), 1)
    assert not references.judge(0, dynamics(12.0, std=3.0), 2).findings


@pytest.mark.parametrize("status", [DynamicsStatus.UNEXCITED, DynamicsStatus.TOO_SLOW])
def test_what_is_not_fitted_has_its_reason_and_no_values(status):
    found = DynamicsReferences().judge(0, NotFitted(status, "because"), 5)
    assert (found.status, found.sentence, found.t) == (status, "because", 5)
    assert all(math.isnan(one.value) for one in found.quantities)


def test_a_frequency_that_is_not_told_is_not_ok():
    found = DynamicsReferences().judge(0, replace(dynamics(20.0), natural_frequency=Quantity()), 1)
    assert found.status is DynamicsStatus.UNEXCITED
    assert len(found.quantities) == len(DYNAMIC_QUANTITIES)


def finding_of(identification):
    (results,) = identification.results.of([0])
    return [one.code for one in results.dynamics[0].findings]


def test_after_a_restart_a_slower_spool_is_still_one(identification, fresh):
    again = fresh()
    identification.judge_dynamics(0, dynamics(20.0), 5)
    (kept,) = [one for one in identification.states.kept() if one.estimator == "Dynamics"]
    restored, refused = again.restore([kept])
    assert (restored, refused) == ([f"{VALVE}.Dynamics"], {})
    again.judge_dynamics(0, dynamics(10.0), 9)
    assert finding_of(again) == [FindingCode.DYNAMICS_CHANGE]
    (kept,) = [one for one in again.states.kept() if one.estimator == "Dynamics"]
    assert kept.t == 5


@pytest.mark.parametrize("how", ["approve", "replace_valve"])
def test_an_approved_or_another_valve_has_a_new_reference(identification, how):
    identification.take(as_changes(plant(600)))
    identification.judge_dynamics(0, dynamics(20.0), 5)
    identification.do(Command.of(how, VALVE))
    identification.judge_dynamics(0, dynamics(10.0), 9)
    assert finding_of(identification) == []


@pytest.mark.parametrize("f", [-1.0, 0.0, math.nan, math.inf])
def test_a_reference_that_no_spool_has_is_refused(f):
    references = DynamicsReferences()
    references.judge(0, dynamics(20.0), 5)
    damaged = replace(references.of[0], natural_frequency=np.array(f)).to_bytes(KEY)
    with pytest.raises(StateMismatchError, match="natural_frequency"):
        references.from_bytes(0, damaged)
