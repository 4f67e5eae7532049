"""The effect of a fault in a sentence, with its unit and compared with the sensor noise."""

from collections.abc import Sequence
from typing import Final, assert_never

from valvemap_rig.circuit import largest_drop, true_flow
from valvemap_rig.condition import AS_NEW, Condition
from valvemap_rig.fault_effects import SPIKE_SHARE
from valvemap_rig.faults import Fault, FaultKind
from valvemap_rig.machine import SENSOR_OF, Machine, MachineSensors
from valvemap_rig.scenario import ValveBench, faultable
from valvemap_rig.sensors import Sensors

_UNITS: Final = {
    "U": "%",
    "T": "K",
    "x": "mm",
    **dict.fromkeys(("p1", "p2", "pP", "pS", "pT", "pA", "pB"), "bar"),
    **dict.fromkeys(("Q", "QA", "QB"), "l/min"),
}
_FULL_PERCENT: Final = 100.0


def fault_effect(fault: Fault, unit: ValveBench | Machine, sensors: Sensors) -> str:
    """Describe the effect of a fault on a valve or machine, oil or sensors, and its duration.

    Examples
    --------
    >>> bench, sensors = ValveBench(), Sensors()
    >>> print(fault_effect(Fault(kind="damage", size=-10), bench, sensors))
    the main edge passes 10 % less: 18 l/min less of 200 at full signal; for good
    >>> print(fault_effect(Fault(kind="offset", signal="p1", size=5, duration_s=3), bench, sensors))
    p1 is off by +5 bar; for 3 s
    >>> print(fault_effect(Fault(kind="damage", edge="PA", size=-10), Machine(), sensors))
    edge PA passes 10 % less; for good
    """
    return f"{_what(fault, unit, sensors)}; {_how_long(fault)}"


def _what(fault: Fault, unit: ValveBench | Machine, sensors: Sensors) -> str:  # noqa: C901, PLR0911, PLR0912 - by kind
    size = fault.size
    concerned = [signal for signal in faultable(unit).signals if fault.affects(signal)]
    signals = ", ".join(concerned)
    noises = unit.sensors if isinstance(unit, Machine) else sensors
    match fault.kind:
        case FaultKind.LEAKAGE:
            return f"the leakage is {1 + size:g} times its own"
        case FaultKind.AIR:
            return f"the oil holds {size:g} % more free air"
        case FaultKind.SUPPLY:
            return f"the supply pressure is {_relative(size)}"
        case FaultKind.FRICTION:
            return f"the friction is {_relative(size)}"
        case FaultKind.LOAD:
            return f"the load is {_relative(size)}"
        case FaultKind.WEAR | FaultKind.DAMAGE if isinstance(unit, Machine):
            where = f"edge {fault.edge} passes" if fault.edge else "all edges pass"
            return f"{where} {abs(size):g} % {'more' if size > 0 else 'less'}"
        case FaultKind.WEAR | FaultKind.DAMAGE:
            than = "more" if size > 0 else "less"
            said = f"the main edge passes {abs(size):g} % {than}"
            return said + _at_full(unit, sensors, Condition(1 + 0.01 * size))
        case FaultKind.EDGE:
            said = f"a gap of {size:g} l/min per √bar is worn into the main edge"
            return said + _at_full(unit, sensors, Condition(gap=size))
        case FaultKind.SLUGGISH:
            return f"the spool's natural frequency is {_relative(size)}" + _of_spool(unit)
        case FaultKind.LAG:
            return f"{signals} lags by {size:g} s more"
        case FaultKind.TEMPERATURE_RAMP:
            return f"the tank gets {abs(size):g} K {'warmer' if size > 0 else 'colder'}"
        case FaultKind.FROZEN:
            return f"{signals} keeps its last value"
        case FaultKind.SPIKES:
            share = f"{100 * SPIKE_SHARE:g} % of {signals}"
            return f"{share} are off by ±{_sized(fault, concerned, noises)}"
        case FaultKind.OFFSET:
            return (
                f"{signals} is off by {'+' if size > 0 else '-'}{_sized(fault, concerned, noises)}"
            )
        case FaultKind.BAD_QUALITY:
            return f"{100 * size:g} % of {signals} have status BadSensorFailure"
        case FaultKind.UNCERTAIN_QUALITY:
            return f"{100 * size:g} % of {signals} have status UncertainSensorNotAccurate"
        case FaultKind.DROP_OUT:
            return f"{100 * size:g} % of {signals} are not sent"
        case FaultKind.CLOCK_STEP:
            return f"source times are off by {size:+g} s"
        case _ as never:
            assert_never(never)


def _relative(percent: float) -> str:
    return f"{abs(percent):g} % {'higher' if percent > 0 else 'lower'}"


def _of_spool(unit: ValveBench | Machine) -> str:
    follows = isinstance(unit, Machine) or unit.valve.spool_hz
    return "" if follows else ", without effect: it follows at once (spool_hz = 0)"


def _at_full(bench: ValveBench | Machine, sensors: Sensors, worn: Condition) -> str:
    """Describe the change of flow at full signal and the largest drop, and the meter's noise."""
    if isinstance(bench, Machine):
        return ""
    dp = largest_drop(bench, _FULL_PERCENT)
    new, now = (float(true_flow(bench, _FULL_PERCENT, dp, worn=c)) for c in (AS_NEW, worn))
    change, noise = now - new, sensors.Q.noise
    said = (
        f": {abs(change):.2g} l/min {'more' if change > 0 else 'less'} of {new:.0f} at full signal"
    )
    hidden = f", within the flow meter's noise of {noise:g} l/min" if abs(change) < noise else ""
    return said + hidden


def _sized(fault: Fault, signals: Sequence[str], sensors: Sensors | MachineSensors) -> str:
    """Describe a size in the signal's unit, and the sensor's noise."""
    signal = signals[0]
    noise = getattr(sensors, SENSOR_OF.get(signal, signal)).noise
    size, unit = abs(fault.size), _UNITS[signal]
    hidden = f", within its noise of {noise:g} {unit}" if size < noise else ""
    return f"{size:g} {unit}{hidden}"


def _how_long(fault: Fault) -> str:
    if fault.kind in {FaultKind.WEAR, FaultKind.TEMPERATURE_RAMP}:
        return f"within {fault.duration_s:g} s, and for good" if fault.duration_s else "for good"
    return f"for {fault.duration_s:g} s" if fault.duration_s else "for good"
