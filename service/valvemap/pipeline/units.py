"""Units of measurement: one table that converts all inputs into %, bar, l/min and °C.

A plant's numbers are converted once, on input; the other modules use these four units only. Codes
are those of UNECE Recommendation 20, by which OPC UA numbers engineering units (Part 8, 5.6.3).
"""

import re
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.vocabulary.signals import SENSORS

UNECE: Final = "http://www.opcfoundation.org/UA/units/un/cefact"


class Quantity(Enum):
    """A measured quantity; its value is the internal unit."""

    OPENING = "%"
    PRESSURE = "bar"
    FLOW = "l/min"
    TEMPERATURE = "°C"
    LENGTH = "mm"
    SPEED = "mm/s"
    ELECTRICAL = "electrical"

    @property
    def noun(self) -> str:
        """The quantity in words."""
        return self.name.lower()


QUANTITY_OF: Final = {
    **{signal.label: Quantity(signal.unit) for signal in SENSORS},
    "dp": Quantity.PRESSURE,
    "required_U": Quantity.OPENING,
    "load": Quantity.PRESSURE,
}
"""By signal, named as in the configuration."""


@dataclass(frozen=True)
class Unit:
    """A unit: ``inside = factor · value + offset`` in the internal unit."""

    symbol: str
    code: str
    quantity: Quantity
    factor: Fraction = Fraction(1)
    offset: Fraction = Fraction(0)
    names: tuple[str, ...] = ()

    @property
    def number(self) -> int:
        """The unitId of OPC UA.

        >>> unit_of("bar").number
        4342098
        """
        return int.from_bytes(self.code.encode(), "big")


def _gauge(symbol: str) -> tuple[str, ...]:
    """Return the names of a unit of pressure against the atmosphere, or of a difference."""
    ends = ("g", "(g)", "(gauge)", "rel", "(rel)", "ü", "(ü)", "d", "(d)")
    return tuple(f"{symbol}{end}" for end in ends)


def _absolute(symbol: str, factor: Fraction, *others: str) -> "Unit":
    """Return the unit of a pressure against vacuum; inside, it is against the atmosphere."""
    ends = ("a", "abs", "abs.", "(abs)", "absolute", "absolut")
    names = tuple(f"{one}{end}" for one in (symbol, *others) for end in ends)
    return Unit(f"{symbol}(a)", "", _P, factor, -_ATMOSPHERE, names)


_PSI = Fraction("0.45359237") * Fraction("9.80665") / Fraction("0.0254") ** 2 / 100_000  # bar
_GALLON = Fraction("3.785411784")  # US, l
_IMPERIAL_GALLON = Fraction("4.54609")  # l
_CUBIC_INCH = Fraction("2.54") ** 3 / 1000  # l
_KELVIN = Fraction("273.15")
_ATMOSPHERE = Fraction("1.01325")  # bar, the standard one

_P, _F, _T = Quantity.PRESSURE, Quantity.FLOW, Quantity.TEMPERATURE
UNITS: Final = (
    Unit("%", "P1", Quantity.OPENING, names=("percent", "pct", "prozent", "% open", "%fs")),
    Unit("1", "C62", Quantity.OPENING, Fraction(100), names=("0-1", "0..1", "ratio", "fraction")),
    Unit("bar", "BAR", _P, names=("bars", *_gauge("bar"))),
    Unit("mbar", "MBR", _P, Fraction(1, 1000), names=("millibar", *_gauge("mbar"))),
    Unit("Pa", "PAL", _P, Fraction(1, 100_000), names=("pascal",)),
    Unit("hPa", "A97", _P, Fraction(1, 1000), names=("hectopascal",)),
    Unit("kPa", "KPA", _P, Fraction(1, 100), names=("kilopascal", *_gauge("kPa"))),
    Unit("MPa", "MPA", _P, Fraction(10), names=("megapascal", "n/mm2", *_gauge("MPa"))),
    Unit("psi", "PS", _P, _PSI, names=("lbf/in2", "lb/in2", *_gauge("psi"))),
    Unit("kgf/cm²", "E42", _P, Fraction("0.980665"), names=("kg/cm2", "kp/cm2")),
    _absolute("bar", Fraction(1)),
    _absolute("mbar", Fraction(1, 1000)),
    _absolute("kPa", Fraction(1, 100)),
    _absolute("MPa", Fraction(10)),
    _absolute("psi", _PSI),
    _absolute("kgf/cm²", Fraction("0.980665"), "kg/cm2"),
    Unit("atm", "ATM", _P, Fraction("1.01325"), names=("atmosphere",)),
    Unit("l/min", "L2", _F, names=("lpm", "l/m", "ltr/min", "liter/min", "litre/min", "dm3/min")),
    Unit("l/s", "G51", _F, Fraction(60), names=("lps", "l/sec", "dm3/s")),
    Unit("l/h", "E32", _F, Fraction(1, 60), names=("lph", "l/hr")),
    Unit("m³/h", "MQH", _F, Fraction(1000, 60), names=("m3/hr", "cbm/h", "cmh")),
    Unit("m³/min", "G53", _F, Fraction(1000)),
    Unit("m³/s", "MQS", _F, Fraction(60_000), names=("m3/sec",)),
    Unit("ml/min", "41", _F, Fraction(1, 1000)),
    Unit("cm³/min", "G49", _F, Fraction(1, 1000), names=("ccm", "cc/min")),
    Unit("cm³/s", "2J", _F, Fraction(60, 1000), names=("cc/s", "ml/s")),
    Unit(
        "gpm",
        "G2",
        _F,
        _GALLON,
        names=("usgpm", "us gpm", "gpm(us)", "gal/min", "us gal/min", "gal(us)/min", "usg/min"),
    ),
    Unit(
        "imp gpm",
        "G3",
        _F,
        _IMPERIAL_GALLON,
        names=("ukgpm", "uk gpm", "igpm", "gal(uk)/min", "imp gal/min", "gpm(uk)", "gpm(imp)"),
    ),
    Unit("ft³/min", "2L", _F, Fraction(1728) * _CUBIC_INCH, names=("cfm",)),
    Unit("in³/min", "G57", _F, _CUBIC_INCH, names=("cim", "cu in/min")),
    Unit("in³/s", "G58", _F, 60 * _CUBIC_INCH, names=("cis", "cu in/s")),
    Unit("°C", "CEL", _T, names=("c", "degc", "deg c", "celsius", "grad c")),
    Unit(
        "°F",
        "FAH",
        _T,
        Fraction(5, 9),
        Fraction(-160, 9),
        names=("f", "degf", "deg f", "fahrenheit"),
    ),
    Unit("K", "KEL", _T, Fraction(1), -_KELVIN, names=("kelvin", "degk")),
    Unit("mm", "MMT", Quantity.LENGTH, names=("millimeter", "millimetre")),
    Unit("cm", "CMT", Quantity.LENGTH, Fraction(10), names=("centimeter", "centimetre")),
    Unit("m", "MTR", Quantity.LENGTH, Fraction(1000), names=("meter", "metre")),
    Unit("mm/s", "C16", Quantity.SPEED, names=("mm/sec", "millimetre per second")),
    Unit("cm/s", "2M", Quantity.SPEED, Fraction(10), names=("cm/sec",)),
    Unit("m/s", "MTS", Quantity.SPEED, Fraction(1000), names=("m/sec", "mps")),
    Unit("m/min", "2X", Quantity.SPEED, Fraction(1000, 60)),
    Unit("in/s", "IU", Quantity.SPEED, Fraction("25.4"), names=("inch/s", "ips")),
    Unit("mA", "4K", Quantity.ELECTRICAL, names=("milliampere",)),
    Unit("V", "VLT", Quantity.ELECTRICAL, names=("volt", "vdc", "v dc")),
    Unit("mV", "2Z", Quantity.ELECTRICAL, names=("millivolt",)),
)
SYMBOLS: Final = tuple(unit.symbol for unit in UNITS)

_ALIKE = str.maketrans({"³": "3", "²": "2", "º": "°", "˚": "°", "∙": "", "·": "", "\u00a0": " "})


def _plain(text: str) -> str:
    """Normalise a unit's name: ignore case, spaces and variants of the degree sign."""
    text = text.strip().casefold().translate(_ALIKE).replace("^", "").replace("**", "")
    return re.sub(r"\s+", "", text).replace("°", "").replace("deg", "")


_BY_NAME = {_plain(name): unit for unit in UNITS for name in (unit.symbol, *unit.names)}
_BY_NUMBER = {unit.number: unit for unit in UNITS if unit.code}
_ABSOLUTE = {u.symbol.removesuffix("(a)"): u for u in UNITS if u.symbol.endswith("(a)")}
_RELATIVE = {u.symbol: _BY_NAME[_plain(base)] for base, u in _ABSOLUTE.items()}


def unit_of(text: str) -> Unit | None:
    """Return the unit of this name, or None; case and spaces are ignored.

    >>> unit_of("US gal/min").symbol, unit_of("degF").symbol, unit_of("kg/cm^2").symbol
    ('gpm', '°F', 'kgf/cm²')
    """
    return _BY_NAME.get(_plain(text))


def absolute(unit: Unit) -> Unit:
    """Return the unit of the same size against vacuum; the unit itself if there is none.

    >>> [absolute(unit_of(text)).symbol for text in ("bar", "psia", "l/min")]
    ['bar(a)', 'psi(a)', 'l/min']
    """
    return _ABSOLUTE.get(unit.symbol, unit)


def relative(unit: Unit) -> Unit:
    """Return the unit of the same size against the atmosphere, as of a difference.

    >>> relative(unit_of("bar(a)")).symbol
    'bar'
    """
    return _RELATIVE.get(unit.symbol, unit)


def is_absolute(unit: Unit) -> bool:
    """Whether a unit is that of a pressure against vacuum."""
    return unit.symbol in _RELATIVE


def unit_by_number(number: int) -> Unit | None:
    """Return the unit with this OPC UA unitId, or None."""
    return _BY_NUMBER.get(number)


def inside(quantity: Quantity) -> Unit:
    """Return the internal unit of a quantity."""
    return next(unit for unit in UNITS if unit.symbol == quantity.value)


@dataclass(frozen=True)
class Scaling:
    """``inside = gain · value + offset``; the gain is not 0."""

    gain: float = 1.0
    offset: float = 0.0

    @property
    def is_identity(self) -> bool:
        """Whether values are unchanged, bitwise."""
        return self.gain == 1.0 and self.offset == 0.0

    def __call__(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return values in the internal unit; the same array if the scaling is the identity."""
        if self.is_identity:
            return values
        return np.asarray(values * self.gain + self.offset)

    def back(self, value: float) -> float:
        """Return the external value of an internal one."""
        return (value - self.offset) / self.gain


def scaling_of(
    unit: Unit,
    raw: tuple[float, float] | None = None,
    scaled: tuple[float, float] | None = None,
) -> Scaling:
    """Return the scaling from a signal's raw numbers to the internal unit.

    Parameters
    ----------
    unit
        Unit of ``scaled``, or of the numbers themselves without ``scaled``.
    raw, scaled
        Two raw numbers, such as 4 and 20 mA, and their values in ``unit``.

    Examples
    --------
    >>> scaling_of(unit_of("%"), raw=(4, 20), scaled=(0, 100))
    Scaling(gain=6.25, offset=-25.0)
    """
    gain, offset = unit.factor, unit.offset
    if raw is not None and scaled is not None:
        (low, high), (least, most) = ((Fraction(x) for x in pair) for pair in (raw, scaled))
        slope = (most - least) / (high - low)
        offset += gain * (least - slope * low)
        gain *= slope
    return Scaling(float(gain), float(offset))


def unit_with(scaling: Scaling, quantity: Quantity) -> Unit | None:
    """Return the unit of a quantity that has this scaling; None if it is one of raw numbers.

    >>> unit_with(scaling_of(unit_of("psi")), Quantity.PRESSURE).symbol
    'psi'
    """
    own = (unit for unit in UNITS if unit.quantity is quantity)
    return next((unit for unit in own if scaling_of(unit) == scaling), None)


@dataclass(frozen=True)
class Measure:
    """Unit and scaling of one signal.

    Attributes
    ----------
    column
        Column in a recording; None: named as the signal.
    unit
        Unit of the numbers, or of ``scaled``; None: that given by the source, else the internal
        unit.
    raw, scaled
        Two raw numbers and their values.
    """

    column: str | None = None
    unit: Unit | None = None
    raw: tuple[float, float] | None = None
    scaled: tuple[float, float] | None = None

    def scaling(self, signal: str) -> Scaling:
        """Return the scaling from a signal's numbers to the internal unit."""
        return scaling_of(self.unit or inside(QUANTITY_OF[signal]), self.raw, self.scaled)
