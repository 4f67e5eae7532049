"""Checkpoints of all valves: packed for the store, and restored if the configuration fits."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from valvemap.model.estimator import StateMismatchError, key_of
from valvemap.pipeline import dynamics_reference, valve_state
from valvemap.pipeline.alignment import AlignmentSettings, optional_in_keys
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
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.review import Reviewed, review
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.pipeline.timing import TimingSettings, TimingState
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
        What is kept of the edges of valves with ports, and of valves behind a shared meter.
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
        self._memory_keys: dict[
            tuple[int, bool | tuple[str, ...], bool], str
        ] = {}  # by fleet, `_has`
        self._timing_keys: dict[int, str] = {}  # both cached on first use: 0.5 ms each
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
            fleet.show_stopped(m)
            self._maps.tabulate(number)
        if known:
            self._maps.refresh()
        return restored, refused

    def _chosen(self, valves: Iterable[int] | None) -> Iterable[int]:
        return range(len(self._valves.plans)) if valves is None else valves

    def _as_kept(self, valve: int) -> ValveState:
        fleet, m = self._valves.at(valve)
        return fleet.state(m)  # without systematic errors, which are not stored

    def _checkpoints_of(self, valve: int, state: ValveState) -> list[Checkpoint]:
        keys = self._valves.estimator_keys(valve)
        return [
            Checkpoint(
                valve=self._valves.plans[valve].name,
                estimator=name,
                key=keys[name],
                t=lane.t,
                state=valve_state.lane_to_bytes(lane, keys[name]),
                lam=lane.lam,
                frozen=lane.frozen,
                meaning=self._meanings[valve],
            )
            for name, lane in state.lanes.items()
        ]

    def _memories_of(self, valve: int, state: ValveState) -> list[Checkpoint]:
        fleet, m = self._valves.at(valve)
        memory = ValveMemory.of(state, self._arrivals.of(valve), dict(fleet.beyond(m)))
        key, name = self._memory_key(valve), self._valves.plans[valve].name
        found = [_beside(name, MEMORY, memory.to_bytes(key), state.t, key)]
        found.append(_beside(name, ALARMS, fleet.alarms.to_bytes(m), state.t))
        found.append(_beside(name, PLACES, fleet.places_to_bytes(m), state.t))
        if self._arrivals.finds_timing:
            key = self._timing_key(valve)
            timing = self._arrivals.timing.valves[valve].state
            found.append(_beside(name, TIMING, timing.to_bytes(key), state.t, key))
        if self._approved.counts[valve]:
            found.append(self._baseline_of(valve))
        key = self._memory_key(valve)
        edge = self._splitter.to_bytes(valve, key)
        if edge is not None:
            found.append(_beside(name, EDGE, edge, state.t, key))
        meter = self._meters.to_bytes(valve, key)
        if meter is not None:
            found.append(_beside(name, METER, meter, state.t, key))
        reference = self._references.of.get(valve)
        if reference is not None:
            packed = reference.to_bytes(dynamics_reference.KEY)
            found.append(_beside(name, DYNAMICS, packed, int(reference.t)))
        return [replace(one, meaning=self._meanings[valve]) for one in found]

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
        lane = valve_state.lane_from_bytes(
            kept.state, configured, kept.lam, frozen=kept.frozen, t=kept.t
        )
        self._valves.put(kept.valve, kept.estimator, lane)
        if lane.count:
            fleet, m = self._valves.at(number)
            fleet.accept(m, kept.estimator)

    def _take_memory(self, kept: Checkpoint) -> None:
        number = self._number(kept)
        fleet, m = self._valves.at(number)
        memory = ValveMemory.from_bytes(
            kept.state, self._memory_key(number), fleet.plan.gate, self._arrivals.alignment
        )
        self._arrivals.put(number, memory.arrivals)
        fleet.remember(m, memory.gate, memory.t, memory.T)
        fleet.demand(m, *memory.demand)
        for name, notes in memory.notes.items():
            known = name in fleet.plan.estimators and notes.status in (-1, *Status)
            if not known or not (lane := fleet.lane(m, name)).t:
                continue  # the estimator was reset
            status = None if notes.status < 0 else Status(notes.status)
            said = replace(lane, predicted=notes.predicted, residual=notes.residual, status=status)
            fleet.put(m, name, said)
            fleet.count_beyond(m, name, notes.beyond)

    def _take_timing(self, kept: Checkpoint) -> None:
        number = self._number(kept)
        if not self._arrivals.finds_timing:
            raise StateMismatchError("how signals come is configured")
        state = TimingState.from_bytes(kept.state, self._timing_key(number))
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
        self._splitter.from_bytes(number, kept.state, self._memory_key(number))

    def _take_meter(self, kept: Checkpoint) -> None:
        number = self._number(kept)
        self._meters.from_bytes(number, kept.state, self._memory_key(number))

    def _take_dynamics(self, kept: Checkpoint) -> None:
        self._references.from_bytes(self._number(kept), kept.state)

    def _take_places(self, kept: Checkpoint) -> None:
        fleet, m = self._valves.at(self._number(kept))
        fleet.places_from_bytes(m, kept.state)
        for name in fleet.plan.estimators:
            if not fleet.lane(m, name).t:  # the estimator was reset
                fleet.reset_errors(m, name)

    def _number(self, kept: Checkpoint) -> int:
        number = self._valves.numbers.get(kept.valve)
        if number is None:
            raise StateMismatchError("no such valve is configured")
        return number

    def _memory_key(self, valve: int) -> str:
        optional, numbered = self._has(valve)
        kind = self._valves.kind(valve), optional, numbered
        if kind not in self._memory_keys:
            gate, settings = self._valves.plans[valve].gate, self._arrivals.alignment.settings
            self._memory_keys[kind] = key_of(_Through(gate, settings, optional, numbered))
        return self._memory_keys[kind]

    def _timing_key(self, valve: int) -> str:
        if valve not in self._timing_keys:
            settings, nodes = self._arrivals.timing.settings, self._valves.plans[valve].nodes
            self._timing_keys[valve] = key_of(_Comes(settings, nodes, *self._has(valve)))
        return self._timing_keys[valve]

    def _has(self, valve: int) -> tuple[bool | tuple[str, ...], bool]:
        """Return a valve's optional signals, as in keys, and whether it has a running number."""
        alignment = self._arrivals.alignment
        numbered = bool(alignment.has_sequence) and alignment.has_sequence[valve]
        return optional_in_keys(alignment.optional[valve]), numbered


def _beside(valve: str, name: str, state: bytes, t: int, key: str = "") -> Checkpoint:
    """Return a checkpoint of state beside the estimators."""
    return Checkpoint(valve, name, key, t, state, lam=None, frozen=False)


# A key also hashes its class's name: renaming a class would reject all stored checkpoints.
@dataclass(frozen=True)
class _Through:
    """The steps between a valve's data changes and its estimators."""

    gate: QualityGate
    alignment: AlignmentSettings
    has_T: bool | tuple[str, ...]
    has_sequence: bool


@dataclass(frozen=True)
class _Comes:
    """The configuration that timing detection depends on."""

    settings: TimingSettings
    nodes: Mapping[str, str]
    has_T: bool | tuple[str, ...]
    has_sequence: bool
