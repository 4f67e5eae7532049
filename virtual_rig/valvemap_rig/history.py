"""The history of a rig's signals: its newest samples in ring buffers."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from guarded_opcua import Records, Span, Variable
from valvemap_rig.information_model import RigNodes
from valvemap_rig.publication import Columns

_MOST_SAMPLES = 1_000_000  # samples of all valves together, 150 bytes each


class RigHistory:
    """The samples of the last ``seconds``; fulfils :class:`guarded_opcua.Historian`."""

    def __init__(self, nodes: RigNodes, seconds: float, rate_hz: float) -> None:
        valves = nodes.of_valves
        length = min(math.ceil(seconds * rate_hz), _MOST_SAMPLES // len(valves))
        signals = [variable for signals, _ in valves for variable in signals]
        self._rings = [
            Ring(signals, length, np.float64),
            Ring([sequence for _, sequence in valves], length, np.uint32),
        ]
        self._ring_of = {variable.id: ring for ring in self._rings for variable in ring.variables}

    @property
    def variables(self) -> list[Variable]:
        """The variables with a history."""
        return [variable for ring in self._rings for variable in ring.variables]

    def keep(self, columns: Columns, rows: slice, now: int) -> None:
        """Store the samples published at ``now`` (UTC ns)."""
        signals, sequences = self._rings
        signals.keep(
            columns.values[rows],
            columns.times[rows],
            now,
            columns.codes[rows],
            columns.present[rows],
        )
        sequences.keep(columns.sequences[rows], columns.t[rows], now)

    def raw(self, variable: Any, span: Span, skip: int, most: int) -> Records:  # noqa: ANN401 - a NodeId
        """Return raw values of a variable, see :class:`guarded_opcua.Historian`."""
        return self._ring_of[variable].raw(variable, span, skip, most)


class Ring:
    """Ring buffer of the last ``length`` samples of variables of one type."""

    def __init__(self, variables: Sequence[Variable], length: int, dtype: DTypeLike) -> None:
        self.variables = tuple(variables)
        self._column = {variable.id: column for column, variable in enumerate(self.variables)}
        shape = length, len(self.variables)
        self._values: NDArray[Any] = np.zeros(shape, dtype)
        self._codes = np.zeros(shape, np.uint32)
        self._present = np.zeros(shape, np.bool_)
        self._source = np.zeros(shape, np.int64)
        self._server = np.zeros(length, np.int64)
        self._kept = 0  # number of samples stored since the start

    def keep(
        self,
        values: NDArray[Any],
        source: NDArray[np.int64],
        now: int,
        codes: ArrayLike = 0,
        present: ArrayLike = 1,
    ) -> None:
        """Store k samples, all (k, variables); times in UTC ns."""
        length, k = len(self._server), len(values)
        places = np.arange(self._kept, self._kept + k) % length
        self._values[places] = values
        self._source[places] = source
        self._codes[places] = codes
        self._present[places] = present
        self._server[places] = now
        self._kept += k

    def raw(self, variable: Any, span: Span, skip: int, most: int) -> Records:  # noqa: ANN401 - a NodeId
        """Return raw values of a variable, see :class:`guarded_opcua.Historian`."""
        column, length = self._column[variable], len(self._server)
        oldest = max(self._kept - length, 0)
        turned = np.roll(self._source[:, column], -oldest)[: self._kept - oldest]
        there = np.roll(self._present[:, column], -oldest)[: len(turned)]
        wanted = np.flatnonzero(there & (turned >= span.low) & (turned <= span.high))
        t = turned[wanted]
        if len(t) and (t[1:] < t[:-1]).any():
            wanted = wanted[np.argsort(t, kind="stable")]
        if span.backwards:
            wanted = wanted[::-1]
        rows = (wanted[skip : skip + most] + oldest) % length
        return Records(
            self._values[rows, column],
            self._codes[rows, column],
            self._source[rows, column],
            self._server[rows],
        )
