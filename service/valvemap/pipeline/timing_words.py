"""Descriptions of the timing of a valve's signals. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.pipeline.kernels.scans import NEVER, NEWEST, Scans
from valvemap.pipeline.scan_search import Comes, Found
from valvemap.vocabulary.signals import READ, Signal

STILL_NS: Final = 30_000_000_000  # time at rest after which an on-change signal is named


@dataclass(frozen=True)
class Words:
    """``found`` is None if the signals have one timestamp; ``there`` (6,) masks those present."""

    found: Found | None
    there: NDArray[np.bool_]
    scans: Scans
    is_found: bool = True

    def sentences(self, labels: Mapping[str, str]) -> tuple[str, ...]:
        """Describe how each signal is stamped; ``labels`` are the names of U and the others."""
        if not self.is_found:
            return ("not found yet",)
        if self.found is None:
            return ("the signals of a sample carry one time",)
        said, shifts = [], np.isfinite(self.found.limit)
        for j in np.flatnonzero(self.there):
            ms, band = self.found.offset[j] * 1e-6, float(self.found.deadband[j])
            said.append(
                f"{labels.get(READ[j], READ[j])}: "
                + {
                    Comes.HELD: "on change, its last value is held"
                    + (f", {ms:.3g} ms after the scan's first" if shifts[j] else "")
                    + (f", steps from {band:.3g} on" if band > 0.0 else ""),
                    Comes.INTERPOLATED: f"{ms:.3g} ms after the scan's first, interpolated",
                    Comes.AS_IT_IS: f"{ms:.3g} ms after the scan's first, taken as it is",
                }.get(Comes(int(self.found.comes[j])), "with the scan's first")
            )
        return tuple(said)

    def losses(self, labels: Mapping[str, str]) -> tuple[str, ...]:
        """Return why scans gave no sample: signal, reason, setting."""
        said = []
        for j in np.flatnonzero(self.there):
            name = labels.get(READ[j], READ[j])
            lacking, moved = int(self.scans.lacking[j]), int(self.scans.moved[j])
            if lacking:
                said.append(
                    f"{name} was not in {lacking} scans: if it comes on change, "
                    f"alignment.hold_s = {{ {READ[j]} = 10 }}"
                )
            if moved and self.found is not None:
                ms = self.found.offset[j] * 1e-6
                said.append(
                    f"{name} moved too fast in {moved} scans to tell where it was {ms:.3g} ms "
                    f"before: alignment.tolerance_ms = {max(1.0, np.ceil(2 * ms)):.0f} takes it "
                    "as it is"
                )
        return tuple(said)

    def still(self, labels: Mapping[str, str]) -> tuple[str, ...]:
        """Return the on-change signals that have not changed for long."""
        if self.found is None:
            return ()
        newest, said = int(self.scans.course[NEWEST]), []
        for j in np.flatnonzero(self.found.comes == Comes.HELD):
            seen = int(self.scans.seen[j])
            if j != Signal.SEQUENCE and seen != NEVER and newest - seen > STILL_NS:
                said.append(
                    f"{labels.get(READ[j], READ[j])} has stood still at "
                    f"{self.scans.now_value[j]:.4g} for {(newest - seen) * 1e-9:.0f} s"
                )
        return tuple(said)
