"""What a user answers `connect`: nodes, units, the name plate, and valves to leave out."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

from valvemap.errors import ConfigurationError
from valvemap.foreign_text import printable
from valvemap.plant.answers import of_valve
from valvemap.plant.candidates import Candidate
from valvemap.plant.evidence import Rating
from valvemap.plant.grouping import Group
from valvemap.plant.reading import WITH_DIFFERENCE, WITH_PRESSURES, Given
from valvemap.plant.reading_questions import as_text


@dataclass(frozen=True)
class Wanted:
    """Answers by valve, the name plate, and valves to leave out; ``assume`` accepts our units.

    All edges of the valves ``ports`` are learnt.
    """

    given: Mapping[str, Given] = field(default_factory=dict)
    rating: Rating = field(default_factory=Rating)
    skip: frozenset[str] = frozenset()
    ports: frozenset[str] = frozenset()
    assume: bool = False

    @property
    def nodes(self) -> frozenset[str]:
        """All nodes that answers name."""
        return frozenset(node for one in self.given.values() for node in one.nodes.values())

    def new_valves(self, found: Collection[str]) -> list[str]:
        """Return the names of valves of which answers name all signals, and which were not found.

        >>> from valvemap.plant.answers import parse_answers
        >>> all_of_V2 = [f"V2.{signal}=s={signal}" for signal in ("U", "dp", "Q")]
        >>> Wanted(parse_answers([*all_of_V2, "V3.U=s=U"], ())).new_valves(["V1"])
        ['V2']
        """
        whole = [set(WITH_PRESSURES), set(WITH_DIFFERENCE)]
        return [
            name
            for name, given in self.given.items()
            if name and name not in found and any(own <= set(given.nodes) for own in whole)
        ]


def with_answers(one: Group, numbers: Sequence[Candidate], wanted: Wanted) -> Group:
    """Add the variables that answers name to a valve's own.

    Raises
    ------
    ConfigurationError
        if there is no such variable.
    """
    there = {candidate.node for candidate in one.all}  # a text is none of them
    more = []
    for role, node in of_valve(wanted.given, one.name).nodes.items():
        if node in there:
            continue
        named = [candidate for candidate in numbers if candidate.node == node]
        if named and named[0].text:
            raise ConfigurationError(
                f"--signal {one.name}.{role}={printable(node)}: the node {as_text(named[0])}"
            )
        if not named:
            raise ConfigurationError(
                f"--signal {one.name}.{role}={printable(node)}: no readable number has this node"
            )
        more += named
    return replace(one, own=(*one.own, *more))


def check_answers(wanted: Wanted, names: Sequence[str]) -> None:
    """Refuse answers for valves that are not there.

    Raises
    ------
    ConfigurationError
        naming the valves that are.

    Examples
    --------
    >>> from valvemap.plant.answers import parse_answers
    >>> check_answers(  # doctest: +ELLIPSIS
    ...     Wanted(parse_answers(["V2.U=s=U"], ())), ["V1"]
    ... )
    Traceback (most recent call last):
        ...
    valvemap.errors.ConfigurationError: V2: no such valve was found; there are: V1; ...
    """
    known = {*names, *wanted.new_valves(names)}
    unknown = ({*wanted.given} - {""} | wanted.skip | wanted.ports) - known
    if unknown:
        there = ", ".join(printable(name) for name in names[:20]) or "none"
        raise ConfigurationError(
            f"{min(unknown)}: no such valve was found; there are: {there}; of a valve that is none "
            "of them, --signal names U, p1, p2 and Q, or U, dp and Q"
        )
