"""The state of all valves as columns, read and restored, and the approved maps."""

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.approved_maps import ApprovedMaps
from valvemap.pipeline.baseline import Baseline
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.sample_intake import SampleIntake
from valvemap.pipeline.valve_columns import Columns, copy_rows


class KeptColumns:
    """State of all valves for callers that align samples themselves: no alignment is included.

    Parameters
    ----------
    valves
        The valves.
    intake, approved
        State beside the fleets'.
    """

    def __init__(self, valves: AllValves, intake: SampleIntake, approved: ApprovedMaps) -> None:
        self._valves = valves
        self._intake = intake
        self._approved = approved
        self._packed: dict[int, bytes] = {}

    def columns(self) -> list[Columns]:
        """Return the state of all valves as columns, without baselines."""
        return [self._of_signals(), *chain.from_iterable(self._of_fleets())]

    def remember(
        self, columns: Sequence[Columns], baselines: Mapping[str, bytes]
    ) -> set[tuple[str, str]]:
        """Restore columns and baselines; return (key, valve) of the states that were reset.

        Raises
        ------
        StateMismatchError
            if a baseline is damaged.
        """
        of_fleets = self._of_fleets()
        afresh = copy_rows(columns, [self._of_signals(), *chain.from_iterable(of_fleets)])
        for fleet, written in zip(self._valves.fleets, of_fleets, strict=True):
            fleet.take_up(written)
        for valve, packed in baselines.items():
            if valve in self._valves.numbers:
                number = self._valves.numbers[valve]
                self._approved.baselines[number] = Baseline.from_bytes(packed)
        return afresh

    def baselines(self) -> dict[str, bytes]:
        """Return the approved maps, packed, by valve.

        A valve whose map cannot be packed is stopped, and keeps the bytes of the last time.
        """
        packed = {}
        for number, found in self._approved.baselines.items():
            with self._valves.bulkhead(number, Step.CHECKPOINT):
                packed[number] = found.to_bytes()
            if number not in packed and number in self._packed:
                packed[number] = self._packed[number]
        self._packed = packed
        return {self._valves.plans[number].name: found for number, found in packed.items()}

    def _of_signals(self) -> Columns:
        names = tuple(plan.name for plan in self._valves.plans)
        intake = self._intake
        plausibility = intake.plausibility.columns()
        every: dict[str, NDArray[Any]] = {
            "newest_t": intake.newest.t,
            "newest_quality": intake.newest.quality,
            "newest_values": intake.newest.values,
            "refuted": intake.refuted,
            "approved": self._approved.counts,
            **{f"plausibility_{name}": array for name, array in plausibility.items()},
        }
        return Columns("signals", names, every)

    def _of_fleets(self) -> list[list[Columns]]:
        """Return the columns of each fleet, in the fleets' order."""
        plans = self._valves.plans
        return [
            fleet.columns([plans[valve].name for valve in own])
            for fleet, own in self._valves.by_fleet(np.arange(len(plans)))
        ]
