"""Checkpoints of all valves: packed for the store, and restored if the configuration fits."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from valvemap.model.estimator import StateMismatchError
from valvemap.pipeline import dynamics_reference, kept_lanes
from valvemap.pipeline.all_alarms import OF_SERVICE, AllAlarms
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.approved_maps import ApprovedMaps
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.baseline import Baseline
from valvemap.pipeline.dynamics_reference import DynamicsReferences
from valvemap.pipeline.edges import Splitter
from valvemap.pipeline.maps_and_surveys import MapsAndSurveys
from valvemap.pipeline.meters import Meters
from valvemap.pipeline.provenance import (
    ALARMS,
    BASELINE,
    DYNAMICS,
    EDGE,
    MEMORY,
    METER,
    PLACES,
    TIMING,
    ValveTerms,
)
from valvemap.pipeline.review import Reviewed, review
from valvemap.pipeline.state_keys import StateKeys
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.pipeline.timing import TimingState
from valvemap.pipeline.valve_memory import ValveMemory
from valvemap.pipeline.valve_state import ValveState
from valvemap.vocabulary.statuses import Status


class KeptStates:
    """Packs the state of valves into checkpoints, and restores it.

    Parameters
    ----------
    valves
        The valves.
    arrivals, approved, alarms
        State stored beside the estimators'.
    maps
        Recomputed after a restore.
    splitter, meters
        Kept states of the edges of valves with ports, and of valves behind a shared meter.
    references
        What the valves' dynamics are compared with.
    """

    def __init__(
        self,
        valves: AllValves,
        arrivals: Arrivals,
        approved: ApprovedMaps,
        alarms: AllAlarms,
        maps: MapsAndSurveys,
        splitter: Splitter,
        meters: Meters,
        references: DynamicsReferences,
    ) -> None:
        self._valves = valves
        self._arrivals = arrivals
        self._approved = approved
        self._alarms = alarms
        self._maps = maps
        self._splitter, self._meters = splitter, meters
        self._references = references
        self._keys = StateKeys(valves, arrivals)
        self._meanings = [
            "" if plan.meaning is None else plan.meaning.to_text() for plan in valves.plans
        ]

    def kept(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """Return `checkpoints` and `memories` of the given valves, or of all."""
        estimators, beside = [], []
        for valve in self._chosen(valves):
            state = self._as_kept(valve)
            estimators += self._checkpoints_of(valve, state)
            beside += self._memories_of(valve, state)
        return [*estimators, *beside, *self._of_service()]

    def review(self, stored: Sequence[Checkpoint]) -> Reviewed:
        """Return stored checkpoints in the terms of the present configuration."""
        return review(stored, self._valves.plans, ValveTerms(self._arrivals.alignment))

    def checkpoints(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """Return every estimator's state as bytes, of the given valves or of all."""
        chosen = self._chosen(valves)
        return [c for valve in chosen for c in self._checkpoints_of(valve, self._as_kept(valve))]

    def memories(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """Return the state beside the estimators as bytes, of the given valves or of all."""
        chosen = self._chosen(valves)
        found = [c for valve in chosen for c in self._memories_of(valve, self._as_kept(valve))]
        return found + self._of_service()

    def restore(self, checkpoints: Sequence[Checkpoint]) -> tuple[list[str], dict[str, str]]:
        """Restore the checkpoints that fit the configuration.

        Returns
        -------
        restored, refused
            names ``<Valve>.<Estimator>``; ``refused`` maps to the reason, and the state is reset.
        """
        restored: list[str] = []
        refused: dict[str, str] = {}
        takers = {
            MEMORY: self._take_memory,
            TIMING: self._take_timing,
            BASELINE: self._take_baseline,
            ALARMS: self._take_alarms,
            PLACES: self._take_places,
            EDGE: self._take_edge,
            METER: self._take_meter,
            DYNAMICS: self._take_dynamics,
        }
        known: set[int] = set()
        for kept in sorted(checkpoints, key=lambda kept: kept.estimator in (MEMORY, PLACES)):
            name = f"{kept.valve}.{kept.estimator}"
            try:
                takers.get(kept.estimator, self._take_estimator)(kept)
            except StateMismatchError as error:
                refused[name] = str(error)
            else:
                restored.append(name)
                if kept.valve in self._valves.numbers:
                    known.add(self._valves.numbers[kept.valve])
        for number in known:
            fleet, m = self._valves.at(number)
            fleet.lanes.show_stopped(m)
            self._maps.tabulate(number)
        if known:
            self._maps.refresh_surveys()
        return restored, refused

    def _chosen(self, valves: Iterable[int] | None) -> Iterable[int]:
        return range(len(self._valves.plans)) if valves is None else valves

    def _as_kept(self, valve: int) -> ValveState:
        fleet, m = self._valves.at(valve)
        return fleet.view(m)  # without systematic errors, which are not stored

    def _checkpoints_of(self, valve: int, state: ValveState) -> list[Checkpoint]:
        keys = self._valves.estimator_keys(valve)
        return [
            Checkpoint(
                valve=self._valves.plans[valve].name,
                estimator=name,
                key=keys[name],
                t=lane.t,
                state=kept_lanes.lane_to_bytes(lane, keys[name]),
                lam=lane.lam,
                frozen=lane.frozen,
                meaning=self._meanings[valve],
            )
            for name, lane in state.lanes.items()
        ]

    def _memories_of(self, valve: int, state: ValveState) -> list[Checkpoint]:
        fleet, m = self._valves.at(valve)
        memory = ValveMemory.of(state, self._arrivals.view(valve), dict(fleet.lanes.beyond(m)))
        key, name = self._keys.of_memory(valve), self._valves.plans[valve].name
        means = self._meanings[valve]
        found = [_beside(name, MEMORY, memory.to_bytes(key), state.t, key, means)]
        found.append(_beside(name, ALARMS, fleet.alarms.to_bytes(m), state.t, "", means))
        found.append(_beside(name, PLACES, fleet.maps.to_bytes(m), state.t, "", means))
        if self._arrivals.finds_timing:
            own = self._keys.of_timing(valve)
            timing = self._arrivals.timing.valves[valve].state
            found.append(_beside(name, TIMING, timing.to_bytes(own), state.t, own, means))
        if self._approved.counts[valve]:
            found.append(replace(self._baseline_of(valve), meaning=means))
        edge = self._splitter.to_bytes(valve, key)
        if edge is not None:
            found.append(_beside(name, EDGE, edge, state.t, key, means))
        meter = self._meters.to_bytes(valve, key)
        if meter is not None:
            found.append(_beside(name, METER, meter, state.t, key, means))
        reference = self._references.of.get(valve)
        if reference is not None:
            packed = reference.to_bytes(dynamics_reference.KEY)
            found.append(_beside(name, DYNAMICS, packed, int(reference.t), "", means))
        return found

    def _of_service(self) -> list[Checkpoint]:
        alarms = self._alarms.of_service
        return [_beside(OF_SERVICE, ALARMS, alarms.to_bytes(), 0)] if alarms.version else []

    def _baseline_of(self, valve: int) -> Checkpoint:
        """Return the baseline; after its deletion, an empty one with ``frozen`` set."""
        found = self._approved.baselines.get(valve)
        kept = found or Baseline.none(int(self._approved.counts[valve]))
        name = self._valves.plans[valve].name
        return replace(_beside(name, BASELINE, kept.to_bytes(), kept.t), frozen=found is None)

    def _take_estimator(self, kept: Checkpoint) -> None:
        number = self._number(kept)
        configured = self._valves.plans[number].estimators.get(kept.estimator)
        if configured is None:
            raise StateMismatchError("no such estimator is configured")
        lane = kept_lanes.lane_from_bytes(
            kept.state, configured, kept.lam, frozen=kept.frozen, t=kept.t
        )
        self._valves.put(kept.valve, kept.estimator, lane)
        if lane.count:
            fleet, m = self._valves.at(number)
            fleet.maps.accept(m, kept.estimator)

    def _take_memory(self, kept: Checkpoint) -> None:
        number = self._number(kept)
        fleet, m = self._valves.at(number)
        memory = ValveMemory.from_bytes(
            kept.state, self._keys.of_memory(number), fleet.plan.gate, self._arrivals.alignment
        )
        self._arrivals.put(number, memory.arrivals)
        fleet.inputs.put(m, memory.gate, memory.t, memory.T)
        fleet.inputs.demand[m] = memory.demand
        for name, notes in memory.notes.items():
            known = name in fleet.plan.estimators and notes.status in (-1, *Status)
            if not known or not (lane := fleet.lane(m, name)).t:
                continue  # the estimator was reset
            status = None if notes.status < 0 else Status(notes.status)
            said = replace(lane, predicted=notes.predicted, residual=notes.residual, status=status)
            fleet.put(m, name, said)
            fleet.lanes.count_beyond(m, name, notes.beyond)

    def _take_timing(self, kept: Checkpoint) -> None:
        number = self._number(kept)
        if not self._arrivals.finds_timing:
            raise StateMismatchError("how signals come is configured")
        state = TimingState.from_bytes(kept.state, self._keys.of_timing(number))
        self._arrivals.timing.put(number, state)

    def _take_baseline(self, kept: Checkpoint) -> None:
        number, found = self._number(kept), Baseline.from_bytes(kept.state)
        self._approved.take_up(number, found, is_approved=not kept.frozen)

    def _take_alarms(self, kept: Checkpoint) -> None:
        if kept.valve == OF_SERVICE:
            self._alarms.of_service.from_bytes(kept.state)
        else:
            fleet, m = self._valves.at(self._number(kept))
            fleet.alarms.from_bytes(m, kept.state)

    def _take_edge(self, kept: Checkpoint) -> None:
        number = self._number(kept)
        self._splitter.from_bytes(number, kept.state, self._keys.of_memory(number))

    def _take_meter(self, kept: Checkpoint) -> None:
        number = self._number(kept)
        self._meters.from_bytes(number, kept.state, self._keys.of_memory(number))

    def _take_dynamics(self, kept: Checkpoint) -> None:
        self._references.from_bytes(self._number(kept), kept.state)

    def _take_places(self, kept: Checkpoint) -> None:
        fleet, m = self._valves.at(self._number(kept))
        fleet.maps.from_bytes(m, kept.state)
        for name in fleet.plan.estimators:
            if not fleet.lane(m, name).t:  # the estimator was reset
                fleet.maps.reset(m, name)

    def _number(self, kept: Checkpoint) -> int:
        number = self._valves.numbers.get(kept.valve)
        if number is None:
            raise StateMismatchError("no such valve is configured")
        return number


def _beside(
    valve: str, name: str, state: bytes, t: int, key: str = "", meaning: str = ""
) -> Checkpoint:
    """Return a checkpoint of state beside the estimators."""
    return Checkpoint(valve, name, key, t, state, lam=None, frozen=False, meaning=meaning)
