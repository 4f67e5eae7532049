"""The sections on the alignment of samples, and on which of them are learnt from."""

from typing import Self

import numpy as np
from pydantic import Field, model_validator

from valvemap.config.sections import Number, Positive, Seconds, Section, per_signal
from valvemap.pipeline.quality_gate import SignalLimits
from valvemap.vocabulary.signals import Measured, Signal


class AlignmentConfig(Section):
    """How the signals of one sample are aligned."""

    tolerance_ms: float = Field(
        0.0,
        ge=0.0,
        le=10_000.0,
        description="largest difference of the times within one sample; 0 = found at the start",
    )
    max_wait_s: float = Field(
        2.0, gt=0.0, le=3_600.0, description="longest wait for a signal that is missing"
    )
    reorder_ms: float = Field(
        1_000.0,
        ge=0.0,
        le=60_000.0,
        description="longest wait behind a gap in nodes.sequence; if given, valves without a "
        "sequence wait this long with every sample",
    )
    max_pending: int = Field(
        4_096, ge=16, le=1_000_000, description="most waiting samples of a valve"
    )
    hold_s: dict[Measured, Seconds] = Field(
        default_factory=dict,
        description="time for which a signal's last value is held; none = found at the start",
    )
    find_timing: bool = Field(
        default=True,
        description="find the timing of signals without a common time at the start, unless "
        "tolerance_ms or hold_s state it",
    )
    stale_after_s: float = Field(
        2.0, gt=0.0, le=3_600.0, description="time without a sample after which results are Bad"
    )

    @property
    def finds_timing(self) -> bool:
        """Whether the timing of the signals is detected instead of configured."""
        return self.find_timing and self.tolerance_ms == 0.0 and not self.hold_s


class LimitsConfig(Section):
    """Limits of one signal in its unit; an omitted limit is not checked."""

    low: Number | None = Field(None, description="lowest accepted value")
    high: Number | None = Field(None, description="highest accepted value")
    frozen_s: float | None = Field(
        None, gt=0.0, le=1e9, description="longest time that the value may be constant"
    )
    max_rate_per_s: Positive | None = Field(None, description="fastest accepted change, per second")
    spike: Positive | None = Field(
        None, description="largest distance from the median of the last five values"
    )

    @model_validator(mode="after")
    def _low_below_high(self) -> Self:
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError(f"low {self.low:g} must be below high {self.high:g}")
        return self

    def limits(self, signal: Signal) -> SignalLimits:
        """Return the gate's limits; the range defaults to that of any real sensor."""
        low, high = signal.plausible
        return SignalLimits(
            low=low if self.low is None else self.low,
            high=high if self.high is None else self.high,
            frozen_s=self.frozen_s or 0.0,
            max_rate_per_s=self.max_rate_per_s or np.inf,
            spike=self.spike or np.inf,
        )


class GateConfig(per_signal("Limits", lambda _: (LimitsConfig, LimitsConfig()))):  # type: ignore[misc]
    """Which samples may teach the estimators."""

    use_uncertain: bool = Field(
        default=False, description="learn from values whose status is Uncertain"
    )
