"""Engineering units by UNECE code (OPC UA Part 8, 5.6.3)."""

from enum import Enum

from asyncua import ua

_NAMESPACE = "http://www.opcfoundation.org/UA/units/un/cefact"


class Unit(Enum):
    """A unit: UNECE number, symbol, name.

    >>> Unit.BAR.information.UnitId
    4342098
    """

    BAR = (4342098, "bar", "bar")
    LITRE_PER_MINUTE = (19506, "l/min", "litre per minute")
    DEGREE_CELSIUS = (4408652, "°C", "degree Celsius")
    PERCENT = (20529, "%", "percent")
    SECOND = (5457219, "s", "second")
    HERTZ = (4740186, "Hz", "hertz")
    MILLIMETRE = (5066068, "mm", "millimetre")
    MILLIMETRE_PER_SECOND = (4403510, "mm/s", "millimetre per second")
    ONE = (4404786, "1", "one")

    @property
    def information(self) -> ua.EUInformation:
        """The EUInformation of the unit."""
        number, symbol, name = self.value
        return ua.EUInformation(
            NamespaceUri=_NAMESPACE,
            UnitId=number,
            DisplayName=ua.LocalizedText(symbol),
            Description=ua.LocalizedText(name),
        )
