"""The effect of a fault in a sentence, with its unit and compared with the sensor noise."""

from typing import Final, assert_never

from valvemap_rig.circuit import largest_drop, true_flow
from valvemap_rig.condition import AS_NEW, Condition
from valvemap_rig.faults import SPIKE_SHARE, Fault, FaultKind
from valvemap_rig.scenario import ValveBench
from valvemap_rig.sensors import Sensors

_UNITS: Final = {"U": "%", "p1": "bar", "p2": "bar", "Q": "l/min", "T": "K"}
_FULL_PERCENT: Final = 100.0


def fault_effect(fault: Fault, bench: ValveBench, sensors: Sensors) -> str:
    """Describe the effect of a fault on a valve, its oil or its sensors, and its duration.

    Examples
    --------
    >>> bench, sensors = ValveBench(), Sensors()
    >>> print(fault_effect(Fault(kind="damage", size=-10), bench, sensors))
    the main edge passes 10 % less: 18 l/min less of 200 at full signal; for good
    >>> print(fault_effect(Fault(kind="offset", signal="p1", size=5, duration_s=3), bench, sensors))
    p1 is off by +5 bar; for 3 s
    """
    return f"{_what(fault, bench, sensors)}; {_how_long(fault)}"


def _what(fault: Fault, bench: ValveBench, sensors: Sensors) -> str:  # noqa: C901, PLR0911 - by kind
    size, signals = fault.size, ", ".join(fault.signals)
    match fault.kind:
        case FaultKind.WEAR | FaultKind.DAMAGE:
            than = "more" if size > 0 else "less"
            said = f"the main edge passes {abs(size):g} % {than}"
            return f"{said}: {_at_full(bench, sensors, Condition(1 + 0.01 * size))}"
        case FaultKind.EDGE:
            said = f"a gap of {size:g} l/min per √bar is worn into the main edge"
            return f"{said}: {_at_full(bench, sensors, Condition(gap=size))}"
        case FaultKind.LAG:
            return f"{signals} lags by {size:g} s more"
        case FaultKind.TEMPERATURE_RAMP:
            return f"the tank gets {abs(size):g} K {'warmer' if size > 0 else 'colder'}"
        case FaultKind.FROZEN:
            return f"{signals} keeps its last value"
        case FaultKind.SPIKES:
            return f"{100 * SPIKE_SHARE:g} % of {signals} are off by ±{_sized(fault, sensors)}"
        case FaultKind.OFFSET:
            return f"{signals} is off by {'+' if size > 0 else '-'}{_sized(fault, sensors)}"
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


def _at_full(bench: ValveBench, sensors: Sensors, worn: Condition) -> str:
    """Describe the change of flow at full signal and the largest drop, and the meter's noise."""
    dp = largest_drop(bench, _FULL_PERCENT)
    new, now = (float(true_flow(bench, _FULL_PERCENT, dp, worn=c)) for c in (AS_NEW, worn))
    change, noise = now - new, sensors.Q.noise
    said = f"{abs(change):.2g} l/min {'more' if change > 0 else 'less'} of {new:.0f} at full signal"
    hidden = f", within the flow meter's noise of {noise:g} l/min" if abs(change) < noise else ""
    return said + hidden


def _sized(fault: Fault, sensors: Sensors) -> str:
    """Describe a size in the signal's unit, and the sensor's noise."""
    (signal,) = fault.signals
    size, noise, unit = abs(fault.size), getattr(sensors, signal).noise, _UNITS[signal]
    hidden = f", within its noise of {noise:g} {unit}" if size < noise else ""
    return f"{size:g} {unit}{hidden}"


def _how_long(fault: Fault) -> str:
    if fault.kind in {FaultKind.WEAR, FaultKind.TEMPERATURE_RAMP}:
        return f"within {fault.duration_s:g} s, and for good" if fault.duration_s else "for good"
    return f"for {fault.duration_s:g} s" if fault.duration_s else "for good"
