"""State of the detection of one valve's timing, as it is stored. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from valvemap.model.contents import Contents
from valvemap.model.estimator import State
from valvemap.pipeline.kernels import scans as kernel
from valvemap.pipeline.scan_search import Comes
from valvemap.vocabulary.signals import PER_VALVE

LISTENING, DOUBTFUL, ALIKE, IN_SCANS = range(4)  # state of the detection


@dataclass(frozen=True)
class TimingSettings:
    """When a scan is complete; ns.

    ``horizon_ns``: a value is missing once other signals are newer by this much.
    ``max_wait_ns``: a source time that steps back by more is a step of the source's clock.
    """

    horizon_ns: int = 1_000_000_000
    max_wait_ns: int = 2_000_000_000


@dataclass(frozen=True)
class TimingState(State):
    """State of the detection of one valve's timing, and the changes buffered for scans.

    ``stands`` () is LISTENING, DOUBTFUL, ALIKE or IN_SCANS; ``comes``, ``offset``, ``limit``,
    ``jitter``, ``deadband`` (6,), ``period`` and ``window`` () are those of `Found`; arrays named
    ``back_…`` (N,) hold the held-back changes; the rest are the arrays of `Scans`.
    """

    stands: Any
    comes: Any
    offset: Any
    limit: Any
    jitter: Any
    deadband: Any
    period: Any
    window: Any
    back_signal: Any
    back_value: Any
    back_status: Any
    back_time: Any
    time: Any
    signal: Any
    value: Any
    status: Any
    now_value: Any
    now_status: Any
    now_time: Any
    now_rate: Any
    seen: Any
    lacking: Any
    moved: Any
    course: Any

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content; ``course`` must count all buffered changes."""
        times = ("offset", "back_time", "time", "now_time", "seen", "course")
        found = {name: Contents(getattr(self, name)).any_time() for name in times}
        raw = ("limit", "jitter", "back_value", "value", "now_value", "now_rate")
        for name in raw:
            found[name] = Contents(getattr(self, name)).or_nan().or_infinite()
        for name in ("back_signal", "signal"):
            found[name] = Contents(getattr(self, name)).within(0, PER_VALVE - 1)
        for name in ("limit", "jitter"):
            found[name].within(0.0)
        found["deadband"] = Contents(self.deadband).within(0.0)
        size = int(self.course[kernel.SIZE])
        found["course"].within(size, size, kernel.SIZE)
        found["stands"] = Contents(self.stands).within(LISTENING, IN_SCANS)
        found["comes"] = Contents(self.comes).within(min(Comes), max(Comes))
        return found
