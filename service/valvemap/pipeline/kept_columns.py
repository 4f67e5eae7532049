"""What all valves remember as columns, given out and written back, and the maps people approved."""

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.approved_maps import ApprovedMaps
from valvemap.pipeline.baseline import Baseline
from valvemap.pipeline.sample_intake import SampleIntake
from valvemap.pipeline.valve_columns import Columns, copy_rows


class KeptColumns:
    """All valves at once, for whom samples are aligned before they arrive: none wait here.

    Parameters
    ----------
    valves
        Of these.
    intake, approved
        What is remembered beside what the fleets remember.
    """

    def __init__(self, valves: AllValves, intake: SampleIntake, approved: ApprovedMaps) -> None:
        self._valves = valves
        self._intake = intake
        self._approved = approved

    def columns(self) -> list[Columns]:
        """All that the valves remember of their samples; no baselines."""
        return [self._of_signals(), *chain.from_iterable(self._of_fleets())]

    def remember(
        self, columns: Sequence[Columns], baselines: Mapping[str, bytes]
    ) -> set[tuple[str, str]]:
        """Take up columns and baselines; return (key, valve) of what starts afresh.

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
        """The approved maps, packed, by valve."""
        return {
            self._valves.plans[number].name: found.to_bytes()
            for number, found in self._approved.baselines.items()
        }

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
        """Of each fleet, in their order."""
        plans = self._valves.plans
        return [
            fleet.columns([plans[valve].name for valve in own])
            for fleet, own in self._valves.by_fleet(np.arange(len(plans)))
        ]
