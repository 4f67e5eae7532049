"""Several valves behind one flow meter: the meter's flow becomes that of each valve. Pure.

    Q_m = Q - Σ Q̂_k,   k ≠ m

Samples of all valves with equal times meet. The flow of the other valves is predicted from the
samples before (:class:`~valvemap.model.shared_meter.SharedMeter`); everything behind is as for a
valve with a meter of its own. Learnt are the samples that say as much of a valve as one alone.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.contents import Contents
from valvemap.model.estimator import State, StateMismatchError, key_of
from valvemap.model.samples import Samples
from valvemap.model.shared_meter import LEAK_PRECISION, SharedMeter, SharedMeterState
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.edges import NEVER_MET, UNKNOWN, gathered, matched
from valvemap.vocabulary.signals import MEASURED
from valvemap.vocabulary.statuses import Quality

MOST_WAITING: Final = 4_096  # samples of a valve that wait for those of the others
_KNOWN: Final = 0.3  # of the meter's noise; standard deviation of the other valves' flow

Flags = NDArray[np.bool_]
Stop = Callable[[int, Exception], None]


@dataclass(frozen=True)
class _Kept(State):
    """What waits of one valve; of the first behind a meter, what the meter knows, too."""

    t: Any
    values: Any
    quality: Any
    weights: Any
    P: Any
    sums: Any
    held: Any
    dropped: Any
    met: Any

    state_version: ClassVar[int] = 4  # 3: leaks had no bound; 2: neither losses nor last match

    @classmethod
    def upgraded(cls, version: str, arrays: dict[str, Any]) -> dict[str, Any]:
        """Add the bound of the leaks, the count of losses and the time of the last match."""
        if len(arrays.get("sums", ())):  # of the first valve behind a meter
            arrays["sums"] = np.append(arrays["sums"], LEAK_PRECISION)
        return {"2": arrays | UNKNOWN, "3": arrays}.get(version, {})

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        return {
            "values": Contents(self.values).or_nan(),
            "t": Contents(self.t).any_time(),
            "met": Contents(self.met).any_time(),
            "quality": Contents(self.quality).within(0, 2),
            "sums": Contents(self.sums).within(0.0),
        }

    def is_coherent(self) -> bool:
        """Whether no variance is negative."""
        return bool((np.diag(self.P) >= 0.0).all())


class _Meter:
    """One meter: the numbers of its valves, what it knows, and what waits of each."""

    def __init__(self, valves: Sequence[int], ranges: Sequence[tuple[float, float]]) -> None:
        self.valves = tuple(valves)
        self.law = SharedMeter(tuple(ranges))
        self.begin_again()

    def begin_again(self) -> None:
        self.state = self.law.initial_state()
        self.waiting = [Samples.empty() for _ in self.valves]
        self.met = np.array([NEVER_MET])

    def meet(self, most: int) -> tuple[list[Samples], list[int]]:
        """Return the samples with equal times, and of each valve the number dropped."""
        rows, past = matched([own.t for own in self.waiting], self.met, most)
        met = [own[own_rows] for own, own_rows in zip(self.waiting, rows, strict=True)]
        dropped = (past - rows.shape[1]).tolist()
        self.waiting = [
            own[slice(first, None)] for own, first in zip(self.waiting, past.tolist(), strict=True)
        ]
        return met, dropped

    def share(self, met: Sequence[Samples]) -> tuple[list[Samples], list[Flags]]:
        """Return the samples with each valve's own flow, and which of them are learnt from.

        A bad signal of one valve makes the samples of all bad.
        """
        quality = np.max([own.quality for own in met], axis=0)
        U, dp = (np.stack([getattr(own, name) for own in met]) for name in ("U", "dp"))
        usable = quality != Quality.BAD
        found = self.law.learn(self.state, U, dp, met[0].Q, usable)
        with np.errstate(invalid="ignore"):
            known = (found.std < _KNOWN) | found.told
        samples, used = [], []
        for own, rest, is_known, is_told in zip(met, found.others, known, found.told, strict=True):
            marked = np.where(usable & ~is_known, np.maximum(quality, Quality.UNCERTAIN), quality)
            samples.append(replace(own, Q=own.Q - rest, quality=marked.astype(np.uint8)))
            used.append(is_told | ~usable)
        return samples, used


class Meters:
    """Divides the flow of meters among the valves behind them.

    Parameters
    ----------
    meters
        Name of the meter of each of the V plans; "": it has one of its own.
    ranges
        Their ranges of U, %.
    most
        Samples of a valve that may wait.

    Attributes
    ----------
    dropped : int64
        Samples (V,) that never met one of each other valve.
    """

    def __init__(
        self,
        meters: Sequence[str],
        ranges: Sequence[tuple[float, float]],
        most: int = MOST_WAITING,
    ) -> None:
        self._most = most
        self.dropped = np.zeros(len(meters), np.int64)
        self._of: dict[int, tuple[_Meter, int]] = {}
        for name in dict.fromkeys(name for name in meters if name):
            valves = [number for number, own in enumerate(meters) if own == name]
            meter = _Meter(valves, [ranges[number] for number in valves])
            self._of |= {number: (meter, place) for place, number in enumerate(valves)}

    def __bool__(self) -> bool:
        return bool(self._of)

    def share(self, arrived: ByValve, stop: Stop) -> tuple[ByValve, Mapping[int, Flags]]:
        """Return the samples with each valve's own flow, and which of them are learnt from.

        The flags are of the valves behind shared meters, by number. If a meter raises, what waits
        of its valves is dropped, and ``stop`` is called with each.
        """
        if not self._of:
            return arrived, {}
        parts: dict[int, Samples] = {}
        flags: dict[int, Flags] = {}
        touched: dict[int, _Meter] = {}
        for valve, first, last in zip(*(x.tolist() for x in arrived.segments), strict=True):
            samples = arrived.samples[first:last]
            if valve not in self._of:
                parts[valve] = samples
                continue
            meter, place = self._of[valve]
            meter.waiting[place] = Samples.concatenate([meter.waiting[place], samples])
            touched[meter.valves[0]] = meter
        for meter in touched.values():
            try:
                met, dropped = meter.meet(self._most)
                shared, used = meter.share(met) if len(met[0]) else (met, [])
            except Exception as error:  # noqa: BLE001 - a bulkhead: other valves are divided
                meter.begin_again()
                for valve in meter.valves:
                    stop(valve, error)
                continue
            self.dropped[list(meter.valves)] += dropped
            for valve, samples, is_used in zip(meter.valves, shared, used, strict=False):
                parts[valve], flags[valve] = samples, is_used
        return gathered(parts), flags

    def to_bytes(self, number: int, key: str) -> bytes | None:
        """Pack the state of one valve; None if it has a separate meter."""
        if number not in self._of:
            return None
        meter, place = self._of[number]
        own, known = meter.waiting[place], meter.state
        if place:
            known = SharedMeterState(np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros((0, 2)))
        kept = _Kept(
            *(own.t, own.values, own.quality, known.weights, known.P, known.sums, known.held),
            dropped=np.array(self.dropped[number]),
            met=meter.met,
        )
        return kept.to_bytes(_key(key, meter, place))

    def from_bytes(self, number: int, data: bytes, key: str) -> None:
        """Restore the state of one valve.

        Raises
        ------
        StateMismatchError
            if the bytes are damaged, belong to another meter, or have invalid content.
        """
        if number not in self._of:
            raise StateMismatchError("it has a meter of its own")
        meter, place = self._of[number]
        kept = _Kept.from_bytes(data, _key(key, meter, place))
        N = np.size(kept.t)
        if self._most < N:
            raise StateMismatchError(f"{N} samples wait, {self._most} may")
        fresh = meter.law.initial_state()
        n, sums = (0, 0) if place else (len(fresh.weights), len(fresh.sums))
        like = _Kept(
            t=np.zeros(N, np.int64),
            values=np.zeros((N, len(MEASURED))),
            quality=np.zeros(N, np.uint8),
            weights=np.zeros(n),
            P=np.zeros((n, n)),
            sums=np.zeros(sums),
            held=np.zeros((0 if place else len(meter.valves), 2)),
            **UNKNOWN,
        )
        kept.check(like)
        self.dropped[number] = int(kept.dropped)
        meter.waiting[place] = Samples.from_values(kept.t, kept.values, kept.quality)
        if not place:
            meter.met = kept.met
            meter.state = SharedMeterState(kept.weights, kept.P, kept.sums, kept.held)


def _key(key: str, meter: _Meter, place: int) -> str:
    """Return the key of one valve's bytes: they fit valves with the same ranges, in this order."""
    return f"{key}:{key_of(meter.law)}:{place}"
