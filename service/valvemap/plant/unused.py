"""What becomes of the variables that no valve's reading uses: each has a reason."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from valvemap.foreign_text import printable
from valvemap.plant.candidates import Candidate
from valvemap.plant.grouping import Group
from valvemap.plant.possible import copied, is_unnamed
from valvemap.plant.reading import Record
from valvemap.plant.reading_questions import as_text
from valvemap.plant.roles import LEARNT, QUANTITY, Role
from valvemap.plant.verdict import Verdict

_MOST_NAMED: Final = 6  # variables of a line
_MOST_KINDS: Final = 8  # of variables that are no signal of a valve
_NAME_ALL: Final = (
    "a command, but its pressures or its flow were not found; if it is a valve's, name all: "
    "--signal=NAME.U=… --signal=NAME.p1=… --signal=NAME.p2=… --signal=NAME.Q=…"
)
_CLEAR: Final = 3.0  # nats by which a variable is a command rather than anything else


@dataclass(frozen=True)
class Unused:
    """A variable that no reading uses, and why; ``is_likely``: by its label it could be one's."""

    variable: Candidate
    reason: str
    is_likely: bool = False


def unused(
    numbers: Iterable[Candidate],
    groups: Sequence[Group],
    verdicts: Sequence[Verdict],
    records: Mapping[str, Record],
) -> list[Unused]:
    """Return the variables that no reading, no option and no row of a sheet has, with reasons.

    ``records`` are the values seen, by valve.
    """
    named = {node for verdict in verdicts for node in _named(verdict)}
    used = [one for v in verdicts if v.reading is not None for one in v.reading.nodes.values()]
    of_group = {one.node: own for own in groups for one in (*own.all, *own.texts)}
    by_name = {one.valve: one for one in verdicts}
    found = []
    for one in numbers:
        group = of_group.get(one.node)
        verdict = None if group is None else by_name.get(group.name)
        is_left_out = group is not None and verdict is None  # by --skip, or refused: said
        if one.node not in named and not is_left_out:
            found.append(_of(one, verdict, records, used))
    return found


def of_signals(found: Iterable[Unused]) -> Iterator[str]:
    """Yield a line for each reason why variables that could be a valve's are not used."""
    kinds: dict[str, list[str]] = {}
    for one in found:
        if one.is_likely:
            path, node = "/".join(one.variable.path), one.variable.node
            shown = f"{path} ({node})" if one.variable.label.role is Role.U else path
            kinds.setdefault(one.reason, []).append(shown)
    for reason, names in kinds.items():
        yield f"{_listed(names)}: {reason}"


def of_others(found: Iterable[Unused]) -> Iterator[str]:
    """Yield one line for all other variables: how many are what, with an example of each."""
    kinds: dict[str, list[str]] = {}
    for one in found:
        if not one.is_likely:
            kinds.setdefault(one.reason, []).append("/".join(one.variable.path))
    ordered = sorted(kinds.items(), key=lambda kind: -len(kind[1]))
    said = [
        f"{len(paths):,} {reason} ({printable(paths[0])}{', …' if len(paths) > 1 else ''})"
        for reason, paths in ordered[:_MOST_KINDS]
    ]
    more = sum(len(paths) for _, paths in ordered[_MOST_KINDS:])
    said += [f"{more:,} others"] if more else []
    if said:
        yield "; ".join(said)


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMED
    shown = ", ".join(printable(name) for name in names[:_MOST_NAMED])
    return f"{shown} and {more:,} more (--sheet lists them)" if more > 0 else shown


def _named(verdict: Verdict) -> Iterator[str]:
    """Yield the nodes that are shown with a valve: its signals, those beside, and of options."""
    if verdict.reading is not None:
        for one in verdict.reading.nodes.values():
            yield one.node
            if one.companion is not None:
                yield one.companion.node
    if verdict.question is None:
        yield from verdict.others
        return
    for option in verdict.question.options:
        answers = (a for a in option.answers if a.startswith("--signal="))
        yield from (answer.split("=", 2)[2] for answer in answers)


def _of(
    one: Candidate,
    verdict: Verdict | None,
    records: Mapping[str, Record],
    used: Sequence[Candidate],
) -> Unused:
    role = one.label.role
    if one.text:
        return Unused(one, as_text(one), is_likely=True)
    if is_unnamed(one):
        return Unused(one, "whose name and unit say nothing")
    if role not in LEARNT or one.label.evidence[role] <= 0.0:
        return Unused(
            one, "of another quantity" if role in LEARNT else f"by name {_in_words(role)}"
        )
    record = Record() if verdict is None else records[verdict.valve]
    if (original := copied(one, record, used)) is not None:
        return Unused(one, f"the same values as {printable(original.node)}", is_likely=True)
    if verdict is None or verdict.reading is None:
        return _of_no_valve(one, role)
    return Unused(one, _beside(role, verdict.valve), is_likely=True)


def _beside(role: Role, valve: str) -> str:
    if role is Role.T:
        others = f"a temperature of {valve} at most: others are as likely"
        return f"{others}; --signal={valve}.T=NODE takes one"
    return f"{_in_words(role)} of {valve}, but another one is likelier"


def _of_no_valve(one: Candidate, role: Role) -> Unused:
    if role is Role.U and one.label.gain(Role.U) > _CLEAR:
        return Unused(one, _NAME_ALL, is_likely=True)
    return Unused(one, f"{_in_words(role)} of no valve that was found", role is not Role.T)


def _in_words(role: Role) -> str:
    """Return the role with its article.

    >>> [_in_words(role) for role in (Role.U, Role.P1, Role.QB, Role.OTHER, Role.SPOOL)]
    ['a command', 'a pressure', 'a flow', 'of another quantity', 'a spool position']
    """
    if role is Role.U:
        return "a command"
    if role is Role.OTHER:
        return "of another quantity"
    return f"a {QUANTITY[role].noun if role in LEARNT else role}"
