"""Valves with ports: the samples of a line become those of its two edges. Pure.

    Q_A = Q_PA - Q_AT + leakage,   Q_B = Q_PB - Q_BT + leakage

U opens one edge of a line at a time: its flow is that of the line less the leakage, which the
line's own estimator predicts from the samples before. An edge has |U|, its own pressures and its
own flow; everything behind is as for a valve with one edge.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.contents import Contents
from valvemap.model.estimator import State, StateMismatchError
from valvemap.model.samples import Floats, Samples, Segments, Times
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.kernels import edges as kernel
from valvemap.pipeline.lane_failures import Stop
from valvemap.vocabulary.edges import Edge
from valvemap.vocabulary.signals import MEASURED

LEAK: Final = "Leak"  # the estimator of a line
MOST_WAITING: Final = 4_096  # samples of an edge that wait for those of its line, and vice versa
NEVER_MET: Final = int(np.iinfo(np.int64).min)
UNKNOWN: Final = {"dropped": np.array(0), "met": np.array([NEVER_MET])}  # of states that lack it

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Part:
    """What a plan is of a valve with ports: an edge, or (``edge`` is None) a line."""

    valve: str
    line: str
    edge: Edge | None = None

    @property
    def line_name(self) -> str:
        """Name of the line's plan."""
        return f"{self.valve}.Line{self.line}"


@dataclass(frozen=True)
class _Kept(State):
    """The state of one edge: side of U, own samples and the line's leakage that wait, losses."""

    state: Any
    t: Any
    values: Any
    quality: Any
    line_t: Any
    leakage: Any
    dropped: Any
    met: Any

    state_version: ClassVar[int] = 3  # 2: neither losses nor the time of the last match

    @classmethod
    def upgraded(cls, version: str, arrays: dict[str, Any]) -> dict[str, Any]:
        """Add the count of the samples that never met their line's, and the last that did."""
        return arrays | UNKNOWN if version == "2" else {}

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        nan = {n: Contents(getattr(self, n)).or_nan() for n in ("values", "leakage")}
        times = {n: Contents(getattr(self, n)).any_time() for n in ("state", "t", "line_t", "met")}
        return {**nan, **times, "quality": Contents(self.quality).within(0, 2)}


class _Waiting:
    """Samples of one edge, and leakage of its line, that wait for each other."""

    def __init__(self) -> None:
        self.state = np.zeros(kernel.PLACES, np.int64)
        self.own = Samples.empty()
        self.line_t: Times = np.empty(0, np.int64)
        self.leakage: Floats = np.empty(0)
        self.met = np.array([NEVER_MET])

    def meet(self, most: int) -> tuple[Samples, Floats, int]:
        """Return the samples that have met the line's, its leakage, and the number dropped."""
        (rows, of), (past_own, past_line) = matched([self.own.t, self.line_t], self.met, most)
        samples, leakage = self.own[rows], self.leakage[of]
        self.own = self.own[slice(past_own, None)]
        self.line_t, self.leakage = self.line_t[past_line:], self.leakage[past_line:]
        return samples, leakage, int(past_own) - len(rows)


class Splitter:
    """Splits the samples of lines into those of edges.

    Parameters
    ----------
    parts
        Part of a valve with ports that each of the V plans is; None: it is a valve.
    names
        Names of the plans.
    most
        Samples of an edge that may wait.

    Attributes
    ----------
    dropped : int64
        Samples (V,) that never met one of the line.
    """

    def __init__(
        self, parts: Sequence[Part | None], names: Sequence[str], most: int = MOST_WAITING
    ) -> None:
        self._parts = tuple(parts)
        self._most = most
        numbers = {name: number for number, name in enumerate(names)}
        self.dropped = np.zeros(len(self._parts), np.int64)
        self._edges: dict[int, tuple[Edge, _Waiting]] = {}
        self._of_line: dict[int, list[int]] = {}
        for number, part in enumerate(self._parts):
            if part is None or part.edge is None:
                continue
            self._edges[number] = part.edge, _Waiting()
            self._of_line.setdefault(numbers[part.line_name], []).append(number)

    def __bool__(self) -> bool:
        return bool(self._edges)

    def divide(self, arrived: ByValve) -> tuple[ByValve, ByValve]:
        """Return the samples of the lines, and all others."""
        members = arrived.segments.members.tolist()
        is_line = np.array([member in self._of_line for member in members], np.bool_)
        return (
            replace(arrived, segments=arrived.segments.of(is_line)),
            replace(arrived, segments=arrived.segments.of(~is_line)),
        )

    def note_leakage(self, line: int, t: Times, leakage: Floats) -> None:
        """Hand the leakage in a line's flow (N,), l/min, to its edges."""
        for number in self._of_line.get(line, ()):
            _, waiting = self._edges[number]
            waiting.line_t = np.concatenate([waiting.line_t, t])
            waiting.leakage = np.concatenate([waiting.leakage, leakage])

    def split(self, arrived: ByValve, stop: Stop) -> tuple[ByValve, Flags]:
        """Return the samples of valves and edges, and which of these are learnt from (N,).

        Edges whose line is ahead have samples, too, though none arrived. If an edge raises, what
        waits of it is dropped, and ``stop`` is called with it.
        """
        parts: dict[int, tuple[Samples, Flags]] = {}
        for valve, first, last in zip(*(x.tolist() for x in arrived.segments), strict=True):
            samples = arrived.samples[first:last]
            if valve in self._edges:
                _, waiting = self._edges[valve]
                waiting.own = Samples.concatenate([waiting.own, samples])
            else:
                parts[valve] = samples, np.ones(len(samples), np.bool_)
        for number in self._edges:
            try:
                samples, used = self._of_edge(number)
            except Exception as error:  # noqa: BLE001 - a bulkhead: the other edges are split
                self._edges[number] = self._edges[number][0], _Waiting()
                stop(number, error)
                continue
            if len(samples):
                parts[number] = samples, used
        return gathered({valve: samples for valve, (samples, _) in parts.items()}), np.concatenate(
            [np.empty(0, np.bool_), *(parts[valve][1] for valve in sorted(parts))]
        )

    def _of_edge(self, number: int) -> tuple[Samples, Flags]:
        edge, waiting = self._edges[number]
        met, leakage, dropped = waiting.meet(self._most)
        self.dropped[number] += dropped
        used = np.empty(len(met), np.bool_)
        samples = replace(met, U=met.U.copy(), Q=met.Q.copy(), quality=met.quality.copy())
        kernel.split(
            *(samples.t, samples.U, samples.Q, samples.quality, leakage),
            *(float(edge.opens), float(edge.adds), waiting.state, used),
        )
        return samples, used

    def to_bytes(self, number: int, key: str) -> bytes | None:
        """Pack the state of one edge; None if the plan is of none."""
        if number not in self._edges:
            return None
        waiting = self._edges[number][1]
        own = waiting.own
        kept = _Kept(
            *(waiting.state, own.t, own.values, own.quality, waiting.line_t, waiting.leakage),
            dropped=np.array(self.dropped[number]),
            met=waiting.met,
        )
        return kept.to_bytes(key)

    def from_bytes(self, number: int, data: bytes, key: str) -> None:
        """Restore the state of one edge.

        Raises
        ------
        StateMismatchError
            if the bytes are damaged, belong to another edge, or have invalid content.
        """
        if number not in self._edges:
            raise StateMismatchError("it is not of an edge")
        kept = _Kept.from_bytes(data, key)
        N, L = np.size(kept.t), np.size(kept.line_t)
        if max(N, L) > self._most:
            raise StateMismatchError(f"{max(N, L)} samples wait, {self._most} may")
        like = _Kept(
            state=np.zeros(kernel.PLACES, np.int64),
            t=np.zeros(N, np.int64),
            values=np.zeros((N, len(MEASURED))),
            quality=np.zeros(N, np.uint8),
            line_t=np.zeros(L, np.int64),
            leakage=np.zeros(L),
            **UNKNOWN,
        )
        kept.check(like)
        self.dropped[number] = int(kept.dropped)
        waiting = self._edges[number][1]
        waiting.state = kept.state
        waiting.own = Samples.from_values(kept.t, kept.values, kept.quality)
        waiting.line_t, waiting.leakage, waiting.met = kept.line_t, kept.leakage, kept.met


def matched(streams: Sequence[Times], last: Times, most: int) -> tuple[Times, Times]:
    """Match the samples of several rows of signals by their times; ``most`` of each may wait.

    ``last`` (1,), UTC ns, is the time of the last match; it is advanced.

    Returns
    -------
    rows
        The rows of the matches within each stream, (streams, n).
    past
        Where the samples begin that wait on, (streams,); those before are matched or dropped.

    Examples
    --------
    >>> matched([np.array([1, 2, 4]), np.array([2, 3])], np.array([NEVER_MET]), 10)
    (array([[1],
           [0]]), array([2, 2]))
    """
    lengths = [len(t) for t in streams]
    rows = np.empty((len(streams), min(lengths)), np.int64)
    past = np.zeros(len(streams), np.int64)
    if not min(lengths):
        n = 0
    else:
        starts = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        n = kernel.meet(np.concatenate(streams), starts, last, rows, past)
    return rows[:, :n], np.maximum(past, np.array(lengths) - most)


def gathered(parts: Mapping[int, Samples]) -> ByValve:
    """Return the samples of valves, by ascending numbers."""
    members = sorted(parts)
    ends = np.cumsum([0, *(len(parts[valve]) for valve in members)])
    return ByValve(
        Samples.concatenate([parts[valve] for valve in members]),
        Segments(
            np.array(members, np.int64), ends[:-1].astype(np.int64), ends[1:].astype(np.int64)
        ),
    )
