"""What a service has to show, found by browsing: valves, estimators, variables. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

ROOT = "Identification"
VERSION = f"{ROOT}.NodeVersion"  # another one: valves came or went
NO_ESTIMATORS = frozenset(
    {"Inverse", "Diagnostics", "Signals", "Alarms", "Baseline", "Identification"}
)
PREFERRED = "Auto"

_LIVE = "Signals."
_STATE = ("Diagnostics.SampleAge", "Diagnostics.Waiting", "Diagnostics.LastAction")
_MAPS = ("Coverage", "CoverageAge")
_FIXED = ("Names", "MapQ", "MapDp", "CoverageU", "CoverageDp")
_NEVER = ("Frame", "FrameNames", "Inverse.Map")


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
        Columns of ``s=<Valve>.Frame``, which brings most numbers at once.
    """

    name: str
    estimators: tuple[str, ...]
    frame_names: tuple[str, ...]

    @property
    def primary(self) -> str:
        """The estimator that speaks for the valve; its map is the one that is inverted.

        >>> Valve("V1", ("RLS", "Auto"), ()).primary
        'Auto'
        """
        return PREFERRED if PREFERRED in self.estimators else self.estimators[0]


@dataclass(frozen=True)
class Variables:
    """Names of a valve's variables, without the valve's own, by how they are looked at.

    Attributes
    ----------
    live
        Followed, as the frame is.
    state
        Read each second.
    slow
        Numbers that move slowly, or that few views show.
    maps
        What a map is drawn of.
    fixed
        What stays as it is.
    """

    live: tuple[str, ...]
    state: tuple[str, ...]
    slow: tuple[str, ...]
    maps: tuple[str, ...]
    fixed: tuple[str, ...]


def sort_variables(valve: Valve, names: Sequence[str]) -> Variables:
    """Sort what was found below a valve; what its frame brings is left out.

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
        if name in framed or name in _NEVER:
            continue
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
