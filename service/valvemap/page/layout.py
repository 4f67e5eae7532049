"""Layout of the service's address space, found by browsing: valves, estimators, variables. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from valvemap.vocabulary.edges import EDGES, LINE_PARTS, PARTS

ROOT = "Identification"
VERSION = f"{ROOT}.NodeVersion"  # changes when valves are added or removed
START = "Service.Start"  # how far the service's start is; kernels are compiled at the first one
PREFERRED = "Auto"

_LIVE = "Signals."
_STATE = (
    *("Diagnostics.SampleAge", "Diagnostics.Waiting", "Diagnostics.LastAction"),
    *("Diagnostics.Findings", "Diagnostics.FindingProbabilities"),
    *("Recommended", "RecommendedReason"),
    *("Commission.State", "Commission.Progress", "Commission.Recording"),
)
_MAPS = ("Coverage", "CoverageAge")
_FIXED = ("Names", "MapQ", "MapDp", "CoverageU", "CoverageDp")
_NEVER = ("Frame", "FrameNames", "Inverse.Map", "Commission.Heartbeat")


@dataclass(frozen=True)
class Valve:
    """One valve.

    Attributes
    ----------
    name
        As in its NodeIds.
    estimators
        In the order of the service.
    frame_names
        Columns of ``s=<Valve>.Frame``, one array variable with most of the valve's numbers.
    """

    name: str
    estimators: tuple[str, ...]
    frame_names: tuple[str, ...]

    @property
    def primary(self) -> str:
        """The estimator whose map is inverted and whose state is shown for the valve.

        >>> Valve("V1", ("RLS", "Auto"), ()).primary
        'Auto'
        """
        return PREFERRED if PREFERRED in self.estimators else self.estimators[0]


class PartKind(StrEnum):
    """Kinds of parts shown by all variables of their nodes, instead of by estimators."""

    LINE = "line"
    AXIS = "axis"


@dataclass(frozen=True)
class Part:
    """A line of a valve with ports, or an axis."""

    name: str
    kind: PartKind


def estimators_of(objects: Sequence[str], frame_names: Sequence[str]) -> tuple[str, ...]:
    """Return which objects of a valve are estimators: those whose status is in the frame.

    >>> estimators_of(("RLS", "Inverse"), ("RLS.Status", "Inverse.RequiredU"))
    ('RLS',)
    """
    return tuple(name for name in objects if f"{name}.Status" in frame_names)


def axis_of(name: str, objects: Sequence[str]) -> Part | None:
    """Return the axis that a folder without estimators is, from the names of its objects.

    >>> axis_of("Press", ("PA", "AT", "PB", "BT", "Inverse"))
    Part(name='Press', kind=<PartKind.AXIS: 'axis'>)
    >>> axis_of("Service", ("Alarms",)) is None
    True
    """
    return Part(name, PartKind.AXIS) if set(EDGES) & set(objects) else None


def part_of(place: Valve | Part) -> Part | None:
    """Return what a place is besides, or instead of, a valve: a line or an axis; None: neither.

    >>> part_of(Valve("Boom.LineA", ("Leak",), ()))
    Part(name='Boom.LineA', kind=<PartKind.LINE: 'line'>)
    >>> part_of(Valve("Boom.PA", ("Auto",), ())) is None
    True
    """
    if isinstance(place, Part):
        return place
    is_line = place.name.rpartition(".")[2] in LINE_PARTS
    return Part(place.name, PartKind.LINE) if is_line else None


def family_of(name: str) -> str:
    """Return the valve with ports that an edge or line belongs to; empty for any other valve.

    >>> family_of("Boom.PA"), family_of("Boom.LineB"), family_of("Boom")
    ('Boom', 'Boom', '')
    """
    owner, _, part = name.rpartition(".")
    return owner if part in PARTS else ""


@dataclass(frozen=True)
class Variables:
    """Names of a valve's variables, relative to the valve, by how they are acquired.

    Attributes
    ----------
    live
        Subscribed, like the frame.
    state
        Read each second.
    slow
        Read every few seconds: numbers that change slowly or that few views show.
    maps
        Read to draw a map.
    fixed
        Read once.
    """

    live: tuple[str, ...]
    state: tuple[str, ...]
    slow: tuple[str, ...]
    maps: tuple[str, ...]
    fixed: tuple[str, ...]


def sort_variables(valve: Valve, names: Sequence[str]) -> Variables:
    """Sort the variables of a valve by acquisition; variables in the frame are omitted.

    >>> found = ("Signals.U", "RLS.Residual", "RLS.ParameterStd", "RLS.Coverage", "Inverse.MapQ")
    >>> sort_variables(Valve("V1", ("RLS",), ("RLS.Residual",)), found)
    ... # doctest: +NORMALIZE_WHITESPACE
    Variables(live=('Signals.U',), state=(), slow=('RLS.ParameterStd',), maps=('RLS.Coverage',),
        fixed=('Inverse.MapQ',))
    """
    framed = {*valve.frame_names, *(f"{e}.ParameterVector" for e in valve.estimators)}
    live, state, slow, maps, fixed = [], [], [], [], []
    for name in names:
        last = name.rpartition(".")[2]
        if name in framed or name in _NEVER or (name.startswith("Dynamics.") and last != "Reason"):
            continue  # of the dynamics, the words have the figures
        if name.startswith(_LIVE):
            live.append(name)
        elif name in _STATE:
            state.append(name)
        elif last in _MAPS:
            maps.append(name)
        elif last.endswith(_FIXED):
            fixed.append(name)
        else:
            slow.append(name)
    return Variables(tuple(live), tuple(state), tuple(slow), tuple(maps), tuple(fixed))
