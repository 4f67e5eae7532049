"""Which generation of each state is restored, with rows made by hand."""

from valvemap.pipeline.store_ports import Checkpoint
from valvemap.storage.checkpoint_generations import restorable
from valvemap.storage.checkpoint_rows import Row


def row(valve: str, estimator: str, saved: int, *, is_damaged: bool = False) -> Row:
    one = Checkpoint(valve, estimator, "key", saved, b"state", lam=None, frozen=False)
    made = Row.of(one, saved % 2, saved)
    return made._replace(state=b"other") if is_damaged else made


def saves(chosen: list[Row]) -> dict[tuple[str, str], int]:
    return {one.name: one.saved for one in chosen}


def test_no_rows_restore_nothing():
    assert restorable([], []) == ([], [])


def test_the_newest_save_of_each_counts_in_order_of_the_names():
    rows = [row("V2", "RLS", 1), row("V1", "RLS", 2), row("V1", "RLS", 1)]
    chosen, damaged = restorable(rows, [])
    assert [one.name for one in chosen] == [("V1", "RLS"), ("V2", "RLS")]
    assert saves(chosen)["V1", "RLS"] == 2
    assert damaged == []


def test_a_damaged_state_takes_its_valve_and_its_group_back_to_one_save():
    newest = [row(valve, name, 2) for valve in "ABC" for name in ("ML", "RLS")]
    rows = [row(valve, name, 1) for valve in "ABC" for name in ("ML", "RLS")] + newest[:1]
    rows += [row("A", "RLS", 2, is_damaged=True), *newest[2:]]
    chosen, damaged = restorable(rows, [("A", "B")])
    assert damaged == ["A.RLS"]
    assert {name[0]: saved for name, saved in saves(chosen).items()} == {"A": 1, "B": 1, "C": 2}


def test_an_older_damaged_generation_changes_nothing():
    chosen, damaged = restorable([row("A", "RLS", 1, is_damaged=True), row("A", "RLS", 2)], [])
    assert saves(chosen) == {("A", "RLS"): 2}
    assert damaged == []


def test_a_state_without_an_earlier_save_remains_and_one_without_a_whole_row_is_absent():
    rows = [row("A", "RLS", 3, is_damaged=True), row("A", "RLS", 2), row("A", "ML", 3)]
    rows += [row("B", "RLS", 3, is_damaged=True)]
    chosen, damaged = restorable(rows, [])
    assert saves(chosen) == {("A", "RLS"): 2, ("A", "ML"): 3}
    assert damaged == ["A.RLS", "B.RLS"]
