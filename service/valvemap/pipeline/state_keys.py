"""Keys of the states beside the estimators': hashes of the configuration that they depend on."""

from collections.abc import Mapping
from dataclasses import dataclass

from valvemap.model.estimator import key_of
from valvemap.pipeline.alignment import AlignmentSettings, optional_in_keys
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.timing import TimingSettings


class StateKeys:
    """Keys of memories and timings; each is cached on first use: 0.5 ms."""

    def __init__(self, valves: AllValves, arrivals: Arrivals) -> None:
        self._valves = valves
        self._arrivals = arrivals
        self._memory_keys: dict[tuple[int, bool | tuple[str, ...], bool], str] = {}
        self._timing_keys: dict[int, str] = {}

    def of_memory(self, valve: int) -> str:
        """Return the key of a valve's memory: of gate, alignment and optional signals."""
        optional, numbered = self._has(valve)
        kind = self._valves.kind(valve), optional, numbered
        if kind not in self._memory_keys:
            gate, settings = self._valves.plans[valve].gate, self._arrivals.alignment.settings
            self._memory_keys[kind] = key_of(_Through(gate, settings, optional, numbered))
        return self._memory_keys[kind]

    def of_timing(self, valve: int) -> str:
        """Return the key of a valve's timing: of its nodes and the settings of detection."""
        if valve not in self._timing_keys:
            settings, nodes = self._arrivals.timing.settings, self._valves.plans[valve].nodes
            self._timing_keys[valve] = key_of(_Comes(settings, nodes, *self._has(valve)))
        return self._timing_keys[valve]

    def _has(self, valve: int) -> tuple[bool | tuple[str, ...], bool]:
        """Return a valve's optional signals, as in keys, and whether it has a running number."""
        alignment = self._arrivals.alignment
        numbered = bool(alignment.has_sequence) and alignment.has_sequence[valve]
        return optional_in_keys(alignment.optional[valve]), numbered


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
