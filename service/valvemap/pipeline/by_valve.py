"""Samples of several valves in one batch. Pure."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from valvemap.model.samples import Samples, Segments


@dataclass(frozen=True)
class ByValve(Mapping[int, Samples]):
    """Samples of several valves, one valve after another: arrays for kernels, mapping by valve.

    ``segments.members`` are the valves' numbers, ascending.
    """

    samples: Samples
    segments: Segments

    def __getitem__(self, valve: int) -> Samples:
        k = int(np.searchsorted(self.segments.members, valve))
        if k == len(self) or self.segments.members[k] != valve:
            raise KeyError(valve)
        return self.samples[slice(self.segments.starts[k], self.segments.stops[k])]

    def __iter__(self) -> Iterator[int]:
        return iter(self.segments.members.tolist())

    def __len__(self) -> int:
        return len(self.segments.members)


def together(parts: Sequence[ByValve]) -> ByValve:
    """Concatenate the samples of different valves, by ascending numbers of the valves."""
    lengths = np.cumsum([0, *(len(part.samples) for part in parts)])
    segments = [
        Segments(part.segments.members, part.segments.starts + at, part.segments.stops + at)
        for part, at in zip(parts, lengths[:-1], strict=True)
    ]
    empty = np.empty(0, np.int64)
    columns = zip(Segments(empty, empty, empty), *segments, strict=True)
    return ByValve(
        Samples.concatenate([part.samples for part in parts]),
        Segments(*map(np.concatenate, columns)),
    )


def in_turn(parts: Sequence[ByValve]) -> ByValve:
    """Concatenate samples that may be of the same valves, those of each in the order of parts."""
    samples = Samples.concatenate([part.samples for part in parts])
    lengths = [part.segments.stops - part.segments.starts for part in parts]
    valve = np.concatenate(
        [np.repeat(part.segments.members, n) for part, n in zip(parts, lengths, strict=True)]
    )
    order = np.argsort(valve, kind="stable")
    members, counts = np.unique(valve, return_counts=True)
    stops = np.cumsum(counts)
    return ByValve(samples[order], Segments(members, stops - counts, stops))
