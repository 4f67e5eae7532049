"""Each claim's verdict on the rig's data, and another verdict on data that say otherwise."""

from dataclasses import replace

import numpy as np
import pytest

from paper import claims_convergence as convergence
from paper import claims_map as of_the_map
from paper import claims_use as use
from paper.data import Points
from paper.evidence import Damage
from paper.learning import error_of_U, lessons
from paper.rig import measure_structured
from paper.verdict import Verdict
from valvemap.model.model_structures import FiveTerms
from valvemap.model.rbf_network import RbfNetwork

REPRODUCED, EXPLAINED, NOT_REPRODUCED = Verdict


def learning(evidence, **recordings):
    """The same evidence with other recordings, and what is learnt from them."""
    data = replace(evidence.data, **recordings)
    known = {
        name: lessons(getattr(data, name), data.new, evidence.network)
        for name in ("structured", "scattered")
        if {name, "new"} & recordings.keys()
    }
    return replace(evidence, data=data, **known)


def flowing(points, Q):
    return replace(points, Q=Q(points.U, points.dp))


def noisy(samples, Q, sigma=0.4):
    noise = sigma * np.random.default_rng(0).normal(size=len(samples))
    return replace(samples, Q=Q(samples.U, samples.dp) + noise)


def eq_7(U, dp):
    return FiveTerms().regressors(U, dp, dp) @ [1.0, 0.02, 0.3, 0.12, -0.01]


def hilly(U, dp):
    return 100.0 + 12.0 * np.cos(U / 16.0) * np.cos(dp / 32.0)


@pytest.mark.parametrize(
    ("claim", "verdict"),
    [
        (convergence.claim_1, REPRODUCED),
        (convergence.claim_2, NOT_REPRODUCED),
        (convergence.claim_4, REPRODUCED),
        (convergence.claim_6, EXPLAINED),
        (convergence.claim_13, REPRODUCED),
        (of_the_map.claim_7, REPRODUCED),
        (of_the_map.claim_9, REPRODUCED),
        (of_the_map.claim_10, REPRODUCED),
        (use.claim_8, NOT_REPRODUCED),
        (use.claim_11, NOT_REPRODUCED),
        (use.claim_12, REPRODUCED),
    ],
)
def test_the_verdicts_that_do_not_hang_on_the_noise(evidence, claim, verdict):
    assert claim(evidence).verdict is verdict


def test_claim_1_is_not_reproduced_where_every_sample_tells_something_new(evidence):
    scattered = replace(evidence, structured=evidence.scattered)
    assert convergence.claim_1(scattered).verdict is NOT_REPRODUCED


def test_claim_1_is_explained_by_28_where_only_lam_squared_forgets_too_much(evidence):
    """60 samples per level: 0.995 remembers three levels, its square one and a half."""
    slow = learning(evidence, structured=measure_structured(3.0))
    assert convergence.claim_1(slow).verdict is EXPLAINED


def test_claim_2_is_reproduced_on_a_map_that_eq_7_cannot_follow(evidence):
    data = evidence.data
    hills = learning(
        evidence, structured=noisy(data.scattered, hilly), new=flowing(data.new, hilly)
    )
    assert convergence.claim_2(hills).verdict is REPRODUCED


def test_claim_3_follows_the_courses_of_rml_in_both_forms(evidence):
    lost, found = evidence.structured.rbf, evidence.scattered.rml
    for right, printed, verdict in [
        (lost, lost, REPRODUCED),
        (found, lost, EXPLAINED),
        (found, found, NOT_REPRODUCED),
    ]:
        known = replace(evidence.structured, rml=right, rml_printed=printed)
        claim = convergence.claim_3(replace(evidence, structured=known))
        assert claim.verdict is verdict


def test_claim_4_is_not_reproduced_where_scattered_data_are_no_better(evidence):
    same = replace(evidence, scattered=evidence.structured)
    assert convergence.claim_4(same).verdict is NOT_REPRODUCED


def test_claim_5_is_reproduced_where_rml_needs_longer(evidence, monkeypatch):
    before = convergence.claim_5(evidence)
    assert before.verdict is not REPRODUCED
    slower = {"RLS": 20.0, "RML": 40.0, "RML as printed": 20.0}
    monkeypatch.setattr(convergence, "settling", lambda *_: slower)
    assert convergence.claim_5(evidence).verdict is REPRODUCED


def test_claim_6_is_not_reproduced_where_small_flows_do_not_blow_up_the_printed_form(evidence):
    def trickle(U, dp):
        return eq_7(U, dp) / 20.0

    data = evidence.data
    small = learning(
        evidence, scattered=noisy(data.scattered, trickle, 0.02), new=flowing(data.new, trickle)
    )
    assert convergence.claim_6(small).verdict is NOT_REPRODUCED


def test_claim_6_is_reproduced_where_too_few_samples_came_in(evidence):
    few = learning(evidence, scattered=evidence.data.scattered[:60])
    assert convergence.claim_6(few).verdict is REPRODUCED


def test_claim_7_is_not_reproduced_of_a_valve_that_is_shut_beyond_what_was_learnt(evidence):
    new = evidence.data.new
    U_max, dp_max = of_the_map.CORNER
    shut = replace(new, Q=np.where((U_max < new.U) | (new.dp > dp_max), -60.0, new.Q))
    claim = of_the_map.claim_7(replace(evidence, data=replace(evidence.data, new=shut)))
    assert claim.verdict is NOT_REPRODUCED


def test_claim_8_is_reproduced_of_a_network_that_a_search_cannot_invert(evidence):
    data = replace(evidence.data, scattered=evidence.data.structured)
    assert use.claim_8(replace(evidence, data=data)).verdict is REPRODUCED


def test_claim_9_is_not_reproduced_where_eq_7_is_the_truth(evidence):
    data = evidence.data
    exact = learning(evidence, scattered=noisy(data.scattered, eq_7), new=flowing(data.new, eq_7))
    assert of_the_map.claim_9(exact).verdict is NOT_REPRODUCED


@pytest.mark.parametrize(
    ("change", "holding"),
    [
        (lambda data: {"hot": data.new}, [False, True, True, True]),
        (lambda data: {"hysteretic": data.scattered}, [True, False, True, True]),
        (lambda _: {"hysteresis": 5.0}, [True, True, False, True]),
        (lambda data: {"lagging": data.scattered}, [True, True, True, False]),
    ],
)
def test_claim_10_is_not_reproduced_where_one_effect_is_not_there(evidence, change, holding):
    data = replace(evidence.data, **change(evidence.data))
    claim = of_the_map.claim_10(replace(evidence, data=data))
    assert [part.holds for part in claim.parts] == holding
    assert claim.verdict is NOT_REPRODUCED


def test_claim_11_is_reproduced_with_a_network_of_a_hundred_neurons(evidence):
    large = replace(evidence, network=RbfNetwork(grid=(10, 10)))
    assert use.claim_11(large).verdict is REPRODUCED


def test_claim_12_is_not_reproduced_where_the_exchanged_structure_is_the_truth(evidence):
    def from_the_other_side(U, dp):
        s = np.sqrt(np.abs(dp))
        return (U - 2.0 - 0.3 * s) / (0.4 + 0.02 * s)

    data = replace(
        evidence.data,
        scattered=noisy(evidence.data.scattered, from_the_other_side),
        new=flowing(evidence.data.new, from_the_other_side),
    )
    assert use.claim_12(replace(evidence, data=data)).verdict is NOT_REPRODUCED


def test_claim_13_is_not_reproduced_without_a_damage(evidence):
    unharmed = replace(evidence, damage=Damage.of(evidence.data.scattered, evidence.data.new))
    assert convergence.claim_13(unharmed).verdict is NOT_REPRODUCED


def test_a_point_without_a_u_counts_against_the_inverse():
    truth = Points(*(np.array([x, x]) for x in (50.0, 100.0, 40.0, 80.0)))
    assert error_of_U(np.array([50.0, np.nan]), truth) == pytest.approx(50.0 / np.sqrt(2))
