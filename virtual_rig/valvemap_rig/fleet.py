"""A fleet of valves: one recording, played for each valve with its own offset and noise.

Simulating a thousand valves needs more than one core; a fleet is meant for load tests, not for
physics. The same scenario gives the same samples bit for bit, for any division into blocks.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap_rig.faults import SIGNALS
from valvemap_rig.randomness import normal
from valvemap_rig.records import Floats
from valvemap_rig.scenario import Scenario
from valvemap_rig.sensors import Sensors
from valvemap_rig.simulation import advance, initial

_NOISE = 8_191  # a prime: a valve's noise does not repeat together with its signals


@dataclass(frozen=True)
class FleetRecording:
    """The recording of a fleet.

    ``signals`` (L, 5) and ``noise`` (M, 5) in the order of ``SIGNALS``; ``starts`` (2, V), the
    offsets of each of the V valves in the two.
    """

    signals: Floats
    noise: Floats
    starts: NDArray[np.int64]

    def samples(self, start: int, n: int) -> Floats:
        """Return samples ``start`` to ``start + n`` of all valves, shape (n, V, 5)."""
        index = np.arange(start, start + n)[:, None]
        shown: Floats = self.signals[(index + self.starts[0]) % len(self.signals)]
        shown += self.noise[(index + self.starts[1]) % len(self.noise)]
        return shown


def valve_names(scenario: Scenario) -> list[str]:
    """Return the names of a fleet's valves, derived from the valve on the bench.

    >>> valve_names(Scenario(fleet={"valves": 100}))[:2]
    ['Valvistor001', 'Valvistor002']
    """
    count = 0 if scenario.fleet is None else scenario.fleet.valves
    width, name = len(str(count)), scenario.valves[0].name
    return [f"{name}{number:0{width}d}" for number in range(1, count + 1)]


def record(scenario: Scenario) -> FleetRecording:
    """Compute the recording of a scenario's fleet from its first valve, without faults.

    Examples
    --------
    >>> record(Scenario(fleet={"valves": 3, "loop_s": 1.0})).samples(7, 2).shape
    (2, 3, 5)
    """
    count = len(valve_names(scenario))
    loop_s = 0.0 if scenario.fleet is None else scenario.fleet.loop_s
    length = max(1, round(loop_s * scenario.sample_rate_hz))
    quiet = {signal: _quiet(getattr(scenario.sensors, signal)) for signal in SIGNALS}
    alone = scenario.model_copy(
        update={
            "valves": scenario.valves[:1],
            "sensors": Sensors(**quiet, T_at=scenario.sensors.T_at),
            "faults": (),
            "duration_s": 0.0,
        }
    )
    _, block = advance(alone, initial(alone, 0), length)
    (valve,) = block.valves.values()
    noise = [
        getattr(scenario.sensors, signal).noise
        * normal(scenario.seed, f"fleet.{signal} noise", 0, _NOISE)
        for signal in SIGNALS
    ]
    rng = np.random.default_rng(scenario.seed)
    return FleetRecording(
        signals=np.stack([getattr(valve, signal) for signal in SIGNALS], axis=1),
        noise=np.stack(noise, axis=1),
        starts=np.stack((rng.integers(0, length, count), rng.integers(0, _NOISE, count))),
    )


def _quiet(sensor: Any) -> Any:  # noqa: ANN401 - a Sensor
    return sensor.model_copy(update={"noise": 0.0, "quantum": 0.0})
