"""Compares the meaning of stored states with the present configuration, before they are restored.

By the meaning of its signals, a state is restored as it is, converted, found under another name, or
set aside: it is never restored under a meaning other than its own. What a state of valves or of
axes needs is told by its `Terms`.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic, Protocol, TypeVar

from valvemap.model.estimator import StateMismatchError
from valvemap.pipeline.meaning import (
    FLOW,
    UNREADABLE,
    Meaning,
    digest_of,
    meaning_of,
    other_accuracies,
    other_nodes,
    other_scaling,
    rescaling,
)
from valvemap.pipeline.store_ports import Checkpoint


@dataclass(frozen=True)
class Aside:
    """A stored state that is not restored, and why."""

    checkpoint: Checkpoint
    reason: str


@dataclass
class Reviewed:
    """Stored states in the terms of the present configuration.

    Attributes
    ----------
    checkpoints
        The states to restore, under their present names and in the present units.
    aside
        The states to keep apart, as they were stored.
    changes
        What changed with the states that are restored: a sentence by ``<Valve>.<Estimator>``.
    moved
        (valve, estimator) as stored, by what they are now: the rows to delete.
    """

    checkpoints: list[Checkpoint] = field(default_factory=list)
    aside: list[Aside] = field(default_factory=list)
    changes: dict[str, str] = field(default_factory=dict)
    moved: dict[tuple[str, str], tuple[str, str]] = field(default_factory=dict)

    @property
    def set_aside(self) -> dict[str, str]:
        """The reasons by ``<Valve>.<Estimator>`` as stored."""
        return {
            f"{one.checkpoint.valve}.{one.checkpoint.estimator}": one.reason for one in self.aside
        }


class Owner(Protocol):
    """The plan of a valve, or of an axis."""

    @property
    def name(self) -> str:
        """Its present name."""

    @property
    def meaning(self) -> Meaning | None:
        """What its signals mean; None: unknown."""


P = TypeVar("P", bound=Owner)


class Change(Generic[P]):
    """How the meaning of an owner's signals differs from that of a stored state."""

    def __init__(self, before: Meaning | None, plan: P, homes: set[str]) -> None:
        now = plan.meaning
        self.before = before if before is not None and now is not None else None
        self.now = now
        self.plan = plan
        self._homes = homes

    @property
    def both(self) -> tuple[Meaning, Meaning]:
        """The meanings before and now."""
        assert self.before is not None  # noqa: S101 - callers check
        assert self.now is not None  # noqa: S101
        return self.before, self.now

    def check_nodes(self, names: tuple[str, ...] = FLOW) -> None:
        """Reject a state of another source or of other nodes."""
        before, now = self.both
        if not _same_source(before, now, self._homes):
            raise StateMismatchError(f"its source was {before.source}, now {now.source}")
        other = other_nodes(before, now, names)
        if other is not None:
            raise StateMismatchError(other)

    def rescaled(self, names: Iterable[str]) -> list[str]:
        """Return the given signals whose unit or scaling changed."""
        return [name for name in names if not rescaling(*self.both, name).is_none]

    def check_scaling(self, names: Iterable[str]) -> None:
        """Reject a state in other units."""
        for name in self.rescaled(names):
            raise StateMismatchError(other_scaling(*self.both, name))

    @property
    def same_drop(self) -> bool:
        """Whether p1 - p2 is unchanged, because both are shifted alike."""
        p1, p2 = (rescaling(*self.both, name) for name in ("p1", "p2"))
        return p1 == p2 and p1.gain == 1.0

    @property
    def T_is_other(self) -> bool:
        """Whether T comes from another node; a sensor that was added or removed is none."""
        before, now = (meaning.node("T") for meaning in self.both)
        return None not in (before, now) and before != now

    @property
    def T_differs(self) -> bool:
        """Whether temperatures before and now cannot be compared."""
        return self.T_is_other or bool(self.rescaled(("T",)))

    def said(self) -> list[str]:
        """Changes that leave a map valid, in words."""
        before, now = self.both
        found = [
            f"{text}: the map is kept, intervals follow" for text in other_accuracies(*self.both)
        ]
        if self.rescaled(("p1",)) and self.same_drop:
            found.append("p1 and p2 are shifted alike: kept")
        if before.source != now.source:
            found.append(
                f"its source was {before.source}, now {now.source}: kept; if that is another "
                "plant, call Reset"
            )
        return found


class Terms(Protocol[P]):
    """The rules that differ between states of valves and of axes."""

    def names(self, rows: Sequence[Checkpoint], plan: P) -> Mapping[str, str]:
        """Return the present names of stored states that were renamed."""

    def kept(self, plan: P) -> Collection[str]:
        """Return the names of all states that the next save replaces."""

    def is_beside(self, name: str) -> bool:
        """Whether a state of this name goes with another one, and is not listed."""

    def as_now(self, own: Checkpoint, change: Change[P]) -> tuple[Checkpoint, list[str]]:
        """Return a state in the present terms, and what changed.

        Raises
        ------
        StateMismatchError
            with the reason in words, if it does not have the present meaning.
        """


def review(stored: Sequence[Checkpoint], plans: Sequence[P], terms: Terms[P]) -> Reviewed:
    """Return the stored states in the terms of the present configuration."""
    found = Reviewed()
    by_valve: dict[str, list[Checkpoint]] = {}
    for one in stored:
        by_valve.setdefault(one.valve, []).append(one)
    homes = {plan.meaning.source for plan in plans if plan.meaning is not None}
    successors = _successors(by_valve, plans, homes)
    named = {plan.name: plan for plan in plans}
    replaced = set(successors.values())
    for name, rows in by_valve.items():
        new = successors.get(name)
        if new is not None:
            _review_rows(rows, named[new], homes, terms, found)
        elif name in replaced and name in named:
            found.aside += [
                Aside(row, f"{name} now has the nodes of another valve") for row in rows
            ]
        else:
            found.checkpoints += rows  # of the service, or of nothing that is configured
    return found


def _successors(
    by_valve: Mapping[str, list[Checkpoint]], plans: Sequence[Owner], homes: set[str]
) -> dict[str, str]:
    """Return the present name of each stored valve that is configured: the nodes decide."""
    names = {plan.name for plan in plans}
    meanings = {name: _newest_meaning(rows) for name, rows in by_valve.items()}
    found: dict[str, str] = {}
    for plan in plans:
        meaning, own = plan.meaning, meanings.get(plan.name)
        if plan.name in by_valve and (meaning is None or own is None or _same(own, meaning, homes)):
            found[plan.name] = plan.name
    for plan in plans:
        if plan.meaning is None or plan.name in found.values():
            continue
        others = [
            name
            for name, meaning in meanings.items()
            if name not in found and meaning is not None and _same(meaning, plan.meaning, homes)
        ]
        if others:
            newest = max(others, key=lambda name: max(row.t for row in by_valve[name]))
            found[newest] = plan.name
    taken = set(found.values())
    for name in by_valve:
        if name in names and name not in found and name not in taken:
            found[name] = name
    return found


def _newest_meaning(rows: Iterable[Checkpoint]) -> Meaning | None:
    known = [(row.t, meaning_of(row.meaning)) for row in rows]
    said = [(t, meaning) for t, meaning in known if meaning is not None]
    return max(said, key=lambda one: one[0])[1] if said else None


def _same(before: Meaning, now: Meaning, homes: set[str]) -> bool:
    """Whether both have the same nodes of one source, which may have moved to another address."""
    return before.nodes == now.nodes and _same_source(before, now, homes)


def _same_source(before: Meaning, now: Meaning, homes: set[str]) -> bool:
    return before.source == now.source or before.source not in homes


def _review_rows(
    rows: Sequence[Checkpoint], plan: P, homes: set[str], terms: Terms[P], found: Reviewed
) -> None:
    names, kept = terms.names(rows, plan), terms.kept(plan)
    for row in rows:
        new = names.get(row.estimator, row.estimator)
        own = replace(row, valve=plan.name, estimator=new)
        try:
            own, said = terms.as_now(own, Change(_meaning_of(row, plan), plan, homes))
        except StateMismatchError as error:
            found.aside.append(Aside(row, str(error)))
            continue
        if plan.meaning is not None and new in kept:
            own = replace(own, meaning=plan.meaning.to_text())
        found.checkpoints.append(own)
        was, now = (row.valve, row.estimator), (plan.name, new)
        if was != now:
            found.moved[was] = now
        if not terms.is_beside(new):
            renamed = [f"was {'.'.join(was)}: found again by its {_by(was, now)}"]
            said = [*(renamed if was != now else []), *said]
            if said:
                found.changes[f"{plan.name}.{new}"] = "; ".join(said)


def _meaning_of(row: Checkpoint, plan: Owner) -> Meaning | None:
    """Return the meaning of a state; None if it is unknown, as in files of older versions.

    Raises
    ------
    StateMismatchError
        if it cannot be read and is not the present one.
    """
    if not row.meaning.startswith(UNREADABLE) or plan.meaning is None:
        return meaning_of(row.meaning)
    if row.meaning != f"{UNREADABLE}{digest_of(plan.meaning.to_text())}":
        raise StateMismatchError("the nodes and units that it was learnt from cannot be read")
    return plan.meaning


def _by(was: tuple[str, str], now: tuple[str, str]) -> str:
    return "nodes" if was[0] != now[0] else "settings"
