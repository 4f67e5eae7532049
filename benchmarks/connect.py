"""How often `connect` finds, asks and errs: generated plants, by their labels and ten seconds.

``python -m benchmarks.connect [--seeds FIRST LAST] [--show]`` prints a row per set: accepted and
right, asked, wrong in silence; and for questions, whether obeying an option gives the truth.
"""

import argparse
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmarks.connect_plants import Plant, contradicted, misstated, plant
from benchmarks.connect_sets import SETS
from benchmarks.connect_third import KINDS, drawn, faulty
from valvemap.app.connect import judged
from valvemap.app.connect_answers import Wanted
from valvemap.plant.answers import of_valve, parse_answers
from valvemap.plant.grouping import Group, group
from valvemap.plant.ports import NAMES
from valvemap.plant.possible import possible_valves
from valvemap.plant.reading import Reading
from valvemap.plant.verdict import Verdict, judge

HELD_OUT: Final = (10_000, 10_200)
"""Seeds of the reported figures; the tables were made without looking at them."""
_EQUAL: Final = 2e-3  # relative difference of values that are equal


@dataclass(frozen=True)
class Outcome:
    """The result for one plant: ``right``, ``asked``, ``wrong`` (in silence); and its story."""

    kind: str
    result: str
    obeyed: bool | None
    story: str


def outcome(subject: Plant) -> Outcome:
    """Judge a plant as `connect` does; obey the first right option of every question."""
    groups = group(subject.candidates)
    groups += possible_valves(subject.candidates, groups)
    verdicts, _ = judged(groups, lambda _: subject.record, Wanted(rating=subject.rating))
    verdicts = [v for v in verdicts if v.reading is not None or v.question is not None]
    known = {v.valve for v in verdicts}
    groups = [one for one in groups if one.name in known]
    if not groups or any(v.question for v in verdicts):
        story = "; ".join(f"{v.valve}: {v.question.about}" for v in verdicts if v.question)
        is_known = not subject.asks or all(_is_of_ports(true) for true in subject.truth.values())
        obeyed = _obeyed(subject, groups, verdicts) if is_known and subject.truth else None
        return Outcome(subject.kind, "asked", obeyed, story or "no valve")
    wrong = [] if subject.asks else list(_errors(subject, verdicts))
    if subject.asks:
        wrong = ["accepted in spite of a contradiction"]
    return Outcome(subject.kind, "wrong" if wrong else "right", None, "; ".join(wrong))


def _errors(subject: Plant, verdicts: Iterable[Verdict]) -> Iterator[str]:
    found = {
        v.reading.nodes[role].node: v.reading
        for v in verdicts
        if v.reading is not None
        for role in v.reading.nodes
        if role == "U"
    }
    for true in subject.truth.values():
        reading = found.pop(true["U"][0], None)
        if reading is None:
            yield "a valve was not found"
        else:
            yield from _differences(reading, true)
    if found:
        yield f"{len(found)} valves too many"


def _differences(reading: Reading, true: Mapping[str, tuple[str, np.ndarray]]) -> Iterator[str]:
    names = NAMES if _is_of_ports(true) else {}
    for role, node in reading.nodes.items():
        name = names.get(role, role)
        if name not in true:
            if role != "T":
                yield f"{role} is {node.path[-1]}"
            continue
        wanted, values = true[name]
        own = reading.values[role]
        same = node.node == wanted
        if not same or not np.allclose(own, values, rtol=_EQUAL, atol=1e-6):
            yield f"{role} is {node.path[-1]} in {reading.scales[role].text}"
    there = {names.get(role, role) for role in reading.nodes}
    for role in true:
        if role not in there and role != "T":
            yield f"{role} is missing"


def _is_of_ports(true: Mapping[str, object]) -> bool:
    return "pA" in true


def _obeyed(subject: Plant, groups: list[Group], verdicts: list[Verdict]) -> bool:
    """Whether some option of every question, obeyed, gives a valve as it is in truth."""
    settled = []
    for own, verdict in zip(groups, verdicts, strict=True):
        if verdict.question is None:
            settled.append(verdict)
            continue
        for option in verdict.question.options:
            signals = [a.removeprefix("--signal=") for a in option.answers if "--signal" in a]
            scales = [a.removeprefix("--scale=") for a in option.answers if "--scale" in a]
            given = of_valve(parse_answers(signals, scales), own.name)
            given = replace(given, ports=f"--ports={own.name}" in option.answers)
            again = judge(own, subject.record, given, subject.rating)
            if again.question is None and not list(_of_one(subject, again)):
                settled.append(again)
                break
    return len(settled) == len(groups) and not list(_errors(subject, settled))


def _of_one(subject: Plant, verdict: Verdict) -> Iterator[str]:
    assert verdict.reading is not None  # noqa: S101 - it has no question
    node = verdict.reading.nodes[next(r for r in verdict.reading.nodes if r == "U")].node
    for true in subject.truth.values():
        if true["U"][0] == node:
            yield from _differences(verdict.reading, true)
            return
    yield "another valve"


def table(name: str, outcomes: list[Outcome], *, show: bool) -> str:
    """Return a row of figures, and with ``show`` the story of each plant not right."""
    counts = Counter(one.result for one in outcomes)
    obeyed = [one.obeyed for one in outcomes if one.obeyed is not None]
    figures = (
        f"{name:28} n {len(outcomes):4}  right {counts['right']:4}  asked {counts['asked']:4}  "
        f"wrong {counts['wrong']:4}  obeyed {sum(obeyed)}/{len(obeyed)}"
    )
    lines = [figures]
    if show:
        lines += [
            f"    {number}: {one.kind}: {one.result}: {one.story[:200]}"
            for number, one in enumerate(outcomes)
            if one.result == "wrong" or (one.result == "asked" and one.obeyed is not None)
        ]
    return "\n".join(lines)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=HELD_OUT)
    parser.add_argument("--show", action="store_true")
    asked = parser.parse_args()
    seeds = range(*asked.seeds)
    print(table("labels right", [outcome(plant(s)) for s in seeds], show=asked.show))
    still = [outcome(plant(s, excitation="rest")) for s in seeds[: len(seeds) // 4]]
    print(table("labels right, nothing moves", still, show=asked.show))
    against = [outcome(contradicted(s)) for s in seeds[: max(50, len(seeds) // 4)]]
    print(table("contradicted", against, show=asked.show))
    for wrong, title in ((False, "flow's unit stated once"), (True, "the same, wrong")):
        flows = [outcome(misstated(s, wrong=wrong)) for s in seeds[: max(50, len(seeds) // 4)]]
        print(table(title, flows, show=asked.show))
    few = seeds[: max(1, len(seeds) // 20)]
    for name, made in SETS.items():
        own = [make(s) for make in made.values() for s in few]
        for asks, title in ((False, "can be known"), (True, "is to be asked")):
            found = [outcome(one) for one in own if one.asks is asks]
            print(table(f"{name} set, {title}", found, show=asked.show))
    third = seeds[: max(len(seeds) // 2, 1)]
    print(table("drawn, labels right", [outcome(drawn(s)) for s in third], show=asked.show))
    for kind in KINDS:
        own = [outcome(faulty(s, kind)) for s in third[: max(len(third) // 4, 1)]]
        print(table(f"drawn, {kind}", own, show=asked.show))


if __name__ == "__main__":
    main()
