"""The benchmark of `connect` in short: its bars on seeds that are not the reported ones."""

from benchmarks.connect import outcome
from benchmarks.connect_plants import contradicted, plant

RIGHT, CAUGHT = 0.9, 0.95  # shares


def test_right_labels_are_accepted_without_a_question_and_none_errs_in_silence():
    found = [outcome(plant(seed)) for seed in range(500, 520)]
    assert not [one.story for one in found if one.result == "wrong"]
    assert sum(one.result == "right" for one in found) >= RIGHT * len(found)
    assert all(one.obeyed for one in found if one.obeyed is not None)


def test_swapped_signals_and_units_off_by_10_14_and_60_are_asked():
    found = [outcome(contradicted(seed)) for seed in range(500, 520)]
    assert sum(one.result == "asked" for one in found) >= CAUGHT * len(found)
