"""Scenarios of the rig, built in or from a TOML file."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Final, Self

from pydantic import Field, ValidationError, model_validator

from valvemap_rig.circuit import Bench
from valvemap_rig.directional import DirectionalValve
from valvemap_rig.excitation import (
    Cycle,
    Excitation,
    External,
    Scattered,
    Structured,
    Verification,
)
from valvemap_rig.faults import EDGES, MACHINE_FAULTS, OF_A_VALVE, Fault, Faultable, FaultKind
from valvemap_rig.machine import Controller, Lead, Machine
from valvemap_rig.parameters import Parameters
from valvemap_rig.sensors import Sensors


class ScenarioError(ValueError):
    """A scenario is missing or invalid; one line names file, field, value and allowed values."""


class ValveBench(Bench):
    """A valve with a name, on a bench of its own."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,63}$")] = "Valvistor"


class Fleet(Parameters):
    """Many valves that play a loop of the first one's recording, each from another place."""

    valves: int = Field(ge=1, le=20_000, description="how many")
    loop_s: float = Field(default=20.0, gt=0, le=3600, description="length of the recording")


class Scenario(Parameters):
    """What runs, how fast, on what valves, seen by what sensors, and what goes wrong."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_ -]{0,63}$")] = "scenario"
    description: str = Field(default="", max_length=500)
    seed: int = Field(default=1, ge=0, le=2**63 - 1, description="same seed, same signals")
    duration_s: float = Field(default=0.0, ge=0, le=1e9, description="simulated time; 0 = endless")
    sample_rate_hz: float = Field(default=100.0, ge=1, le=1000, description="of simulated time")
    time_factor: float = Field(
        default=1.0, ge=1, le=100, description="simulated seconds in one second"
    )
    history_s: float = Field(
        default=360.0,
        ge=0,
        le=86_400,
        description="real time for which the rig remembers its samples, at most a million of them; "
        "0 = none can be asked for",
    )
    excitation: Excitation = Structured()
    valves: tuple[ValveBench, ...] = Field(
        default=(ValveBench(),), max_length=100, description="none: only machines"
    )
    machines: tuple[Machine, ...] = Field(default=(), max_length=20)
    fleet: Fleet | None = None
    sensors: Sensors = Sensors()
    faults: tuple[Fault, ...] = Field(default=(), max_length=100)

    @model_validator(mode="after")
    def _names_fit(self) -> Self:
        names = [unit.name for unit in self.units]
        if not names:
            raise ValueError("valves: there is neither a valve nor a machine")
        if self.fleet is not None and not self.valves:
            raise ValueError("fleet: it plays the first valve's recording, and there is no valve")
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise ValueError(f"valves: name {min(twice)!r} is given twice")
        for fault in self.faults:
            if fault.valve is not None and fault.valve not in names:
                raise ValueError(
                    f"faults: valve {fault.valve!r} is not there; allowed are {', '.join(names)}"
                )
            for unit in self.units:
                if fault.valve in (None, unit.name):
                    self._must_fit(fault, unit)
        return self

    def _must_fit(self, fault: Fault, unit: "ValveBench | Machine") -> None:
        of = faultable(unit)
        if fault.kind not in of.kinds:
            allowed = ", ".join(of.kinds)
            raise ValueError(f"faults: {unit.name} knows no {fault.kind}; allowed are {allowed}")
        if fault.edge is not None and fault.edge not in of.edges:
            raise ValueError(f"faults: {unit.name} has no edge {fault.edge}; leave out edge")
        if fault.signal is not None and fault.signal not in of.signals:
            allowed = ", ".join(of.signals)
            raise ValueError(f"faults: {unit.name} has no {fault.signal}; allowed are {allowed}")

    @property
    def units(self) -> tuple[ValveBench | Machine, ...]:
        """Valves, then machines."""
        return (*self.valves, *self.machines)

    @property
    def samples(self) -> int | None:
        """Number of samples, None if endless."""
        return round(self.duration_s * self.sample_rate_hz) or None


def faultable(unit: ValveBench | Machine) -> Faultable:
    """Return the faults that a valve or a machine can have."""
    if isinstance(unit, ValveBench):
        return OF_A_VALVE
    sensed = tuple(row.name for row in unit.rows if row.sensor is not None)
    return Faultable(MACHINE_FAULTS, sensed, EDGES)


_SIDE_BY_SIDE: Final[tuple[tuple[str, Lead], ...]] = (
    ("PIAlone", "none"),
    ("Table", "table"),
    ("FixedMap", "external"),
    ("LivingMap", "external"),
)

BUILTIN: Mapping[str, Scenario] = MappingProxyType(
    {
        scenario.name: scenario
        for scenario in (
            Scenario(
                name="demo",
                description="Scattered points, held for two samples: identified in seconds.",
                excitation=Scattered(hold_s=0.02),
            ),
            Scenario(
                name="structured",
                description="U in 11 steps; at each, p2 swept down and up in 20 s.",
                excitation=Structured(),
            ),
            Scenario(
                name="scattered",
                description="A new random point of U and pressure drop in every sample.",
                excitation=Scattered(),
            ),
            Scenario(
                name="verification",
                description="1,000 points that are in none of the others.",
                excitation=Verification(),
            ),
            Scenario(
                name="cycle",
                description="The working cycle of a machine, 20 s long.",
                excitation=Cycle(),
            ),
            Scenario(
                name="external",
                description="U from outside (UCommand), against a load that is swept in 20 s.",
                excitation=External(p2_low_bar=20, p2_high_bar=180),
            ),
            Scenario(
                name="feedforward",
                description="Three equal valves, U from outside; damaged for 40 s, then hot oil.",
                excitation=External(sweep_s=40, p2_low_bar=20, p2_high_bar=140),
                valves=tuple(ValveBench(name=n) for n in ("Valvistor", "FixedMap", "FrozenEq7")),
                faults=(
                    Fault(kind=FaultKind.DAMAGE, start_s=20, size=-30, duration_s=40),
                    Fault(kind=FaultKind.TEMPERATURE_RAMP, start_s=75, size=20, duration_s=2),
                ),
            ),
            Scenario(
                name="directional",
                description="A 4/3 valve on a cylinder, a meter in each line; machine work.",
                valves=(),
                machines=(Machine(),),
            ),
            Scenario(
                name="axis",
                description="A 4/3 valve on a cylinder, position and pressures; machine work.",
                valves=(),
                machines=(
                    Machine(
                        name="Axis",
                        measures="position",
                        valve=DirectionalValve(leakage_l_min_bar=0.0),
                    ),
                ),
            ),
            Scenario(
                name="tracking",
                description="Four equal axes, the same moves: PI alone, with a table, with U from "
                "outside twice; two edges damaged after a minute.",
                valves=(),
                machines=tuple(
                    Machine(
                        name=name,
                        measures="position",
                        repeats="Axis",
                        valve=DirectionalValve(leakage_l_min_bar=0.0),
                        controller=Controller(lead=lead),
                    )
                    for name, lead in _SIDE_BY_SIDE
                ),
                faults=tuple(
                    Fault(kind=FaultKind.DAMAGE, start_s=60, size=-30, edge=edge)
                    for edge in ("PA", "BT")
                ),
            ),
        )
    }
)


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Return a built-in scenario by its name, or read one from a TOML file.

    Raises
    ------
    ScenarioError
        in one line: file, field, value, allowed values.

    Examples
    --------
    >>> load_scenario("scattered").excitation.kind
    'scattered'
    >>> load_scenario("circus")
    Traceback (most recent call last):
    valvemap_rig.scenario.ScenarioError: circus: no such file, nor built in: demo, structured, \
scattered, verification, cycle, external, feedforward, directional, axis, tracking
    """
    if str(name_or_path) in BUILTIN:
        return BUILTIN[str(name_or_path)]
    path = Path(name_or_path)
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError as error:
        allowed = ", ".join(BUILTIN)
        raise ScenarioError(f"{path}: no such file, nor built in: {allowed}") from error
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: not TOML: {error}") from error
    try:
        return Scenario.model_validate(values)
    except ValidationError as error:
        raise ScenarioError(f"{path}: {_first_sentence(error)}") from error


def _first_sentence(error: ValidationError) -> str:
    first = error.errors()[0]
    kinds = {"structured", "scattered", "verification", "cycle", "external"}
    field = ".".join(str(part) for part in first["loc"] if part not in kinds)
    sentence = first["msg"].removeprefix("Value error, ").replace("\n", " ")
    if isinstance(first["input"], str | int | float):
        sentence += f", not {first['input']!r}"
    return f"{field}: {sentence}" if field else sentence
