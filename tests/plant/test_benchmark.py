"""The benchmark of `connect` in short: its bars on seeds that are not the reported ones."""

import pytest

from benchmarks.connect import outcome
from benchmarks.connect_plants import contradicted, plant
from benchmarks.connect_sets import SETS
from benchmarks.connect_third import KINDS, drawn, faulty
from valvemap.plant import scores

RIGHT, CAUGHT = 0.9, 0.95  # shares
SEEDS = pytest.mark.parametrize(
    "seeds",
    [range(500, 510), pytest.param(range(510, 535), marks=pytest.mark.soak)],
    ids=["ten", "more"],
)


@pytest.fixture(autouse=True, scope="module")
def each_law_once():
    """Plants differ by their labels more often than by the numbers of which the law is fitted."""
    fit, found = scores.fit, {}

    def known(U, dp, Q, step_s, beside=(), p1=None):
        signals = (U, dp, Q, *(one for pair in beside for one in pair), p1)
        key = (step_s, *(None if one is None else one.tobytes() for one in signals))
        if key not in found:
            found[key] = fit(U, dp, Q, step_s, beside, p1)
        return found[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scores, "fit", known)
        yield


@SEEDS
def test_right_labels_are_accepted_without_a_question_and_none_errs_in_silence(seeds):
    found = [outcome(plant(seed)) for seed in seeds]
    assert not [one.story for one in found if one.result == "wrong"]
    assert sum(one.result == "right" for one in found) >= RIGHT * len(found)
    assert all(one.obeyed for one in found if one.obeyed is not None)


@SEEDS
def test_swapped_signals_and_units_off_by_10_14_and_60_are_asked(seeds):
    found = [outcome(contradicted(seed)) for seed in seeds]
    assert sum(one.result == "asked" for one in found) >= CAUGHT * len(found)


def test_contradictions_that_another_signal_hides_are_asked():
    assert [outcome(contradicted(seed)).result for seed in (30_156, 30_488)] == ["asked"] * 2


@pytest.mark.parametrize("name", SETS["first two"])
def test_no_plant_as_vendors_write_them_is_wrong_in_silence(name):
    found = outcome(SETS["first two"][name](0))
    assert found.result != "wrong", found.story


OF_FIFTH = {name: SETS["fifth"][name] for name in ("mobile_current", "german_ports", "card")}
LATER = OF_FIFTH | {
    name: make
    for of_set in ("fourth", "sixth", "seventh", "eighth", "ninth", "tenth")
    for name, make in SETS[of_set].items()
}
DOUBTFUL = {"mobile_current", "pump_and_supply", "two_loads", "statistics"}
DOUBTFUL |= {"pumps_named_P1_P2", "slow_poll", "finnish"}
"""Plants that can be known, and are asked."""


@pytest.mark.parametrize("name", sorted(LATER.keys() - {"tenth_of_the_flow"}))
def test_plants_of_integrators_are_accepted_or_asked_and_never_wrong(name):
    subject = LATER[name](1)
    found = outcome(subject)
    is_asked = subject.asks or name in DOUBTFUL
    assert found.result == ("asked" if is_asked else "right"), found.story
    assert found.obeyed in {None, True}


@SEEDS
def test_drawn_plants_are_accepted_among_distractors_and_none_errs_in_silence(seeds):
    found = [outcome(drawn(seed)) for seed in seeds]
    assert not [one.story for one in found if one.result == "wrong"]
    assert sum(one.result == "right" for one in found) >= RIGHT * len(found)
    assert all(one.obeyed for one in found if one.obeyed is not None)


@pytest.mark.parametrize("seed", [500, pytest.param(501, marks=pytest.mark.soak)])
def test_faults_that_no_name_shows_are_asked(seed):
    found = [outcome(faulty(seed, kind)) for kind in KINDS]
    assert sum(one.result == "asked" for one in found) >= CAUGHT * len(found)
