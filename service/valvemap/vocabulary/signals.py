"""The measured signals of a valve: one member each, with name, unit, need, range and sentence.

Made from this table: the configuration's fields, the columns of recordings, blocks and samples,
the published nodes, the page's names, and the number of signals in every loop.
"""

from enum import Enum, IntEnum
from typing import TYPE_CHECKING, Final, Literal, Self


class Need(Enum):
    """Whether each valve has the signal."""

    REQUIRED = "required"
    OPTIONAL = "optional"
    """Without a node or a column it is NaN, which is no fault; the samples stay good."""
    COUNTER = "counter"
    """The running number of the samples, which is not measured."""


class Signal(IntEnum):
    """The signals of one valve, in the order of an item's number.

    Attributes
    ----------
    label
        Its name in configuration, nodes and recordings.
    unit
        The unit used everywhere inside the service.
    need
        Whether each valve has it; optional signals follow the required ones, the counter is last.
    plausible
        Range of all sensors: a value outside is not a measurement.
    sentence
        Its description, as a noun.
    caption
        Its name on the page.
    at_rig
        Its name at the virtual rig.

    Examples
    --------
    >>> Signal.P1, Signal.P1.label, Signal.of("p1").unit
    (<Signal.P1: 1>, 'p1', 'bar')
    """

    label: str
    unit: str
    need: Need
    plausible: tuple[float, float]
    sentence: str
    caption: str
    at_rig: str

    def __new__(
        cls,
        value: int,
        label: str = "",
        unit: str = "",
        need: Need = Need.REQUIRED,
        plausible: tuple[float, float] = (0.0, 0.0),
        sentence: str = "",
        caption: str = "",
        at_rig: str = "",
    ) -> Self:
        """Make a member."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.label, member.unit, member.need, member.plausible = label, unit, need, plausible
        member.sentence, member.caption = sentence, caption or label
        member.at_rig = at_rig or label
        return member

    @classmethod
    def of(cls, label: str) -> "Signal":
        """Return the signal of that name; KeyError if there is none."""
        return _BY_LABEL[label]

    U = (
        *(0, "U", "%", Need.REQUIRED, (-1_000.0, 1_000.0)),
        *("control voltage", "U control voltage"),
    )
    P1 = (
        *(1, "p1", "bar", Need.REQUIRED, (-10.0, 10_000.0)),
        *("pressure upstream of the valve", "p₁ upstream"),
    )
    P2 = (
        *(2, "p2", "bar", Need.REQUIRED, (-10.0, 10_000.0)),
        *("pressure downstream of the valve", "p₂ downstream"),
    )
    Q = 3, "Q", "l/min", Need.REQUIRED, (-100_000.0, 100_000.0), "flow", "Q flow"
    T = (
        *(4, "T", "°C", Need.OPTIONAL, (-100.0, 500.0)),
        *("oil temperature", "T oil", "Temperature"),
    )
    SEQUENCE = (
        *(5, "sequence", "", Need.COUNTER, (0.0, 0.0)),
        *("running number of the sample", "", "Sequence"),
    )


_BY_LABEL: Final = {signal.label: signal for signal in Signal}

SENSORS: Final = tuple(signal for signal in Signal if signal.need is not Need.COUNTER)
MEASURED: Final = tuple(signal.label for signal in SENSORS)
"""Names of what a sample consists of."""
REQUIRED: Final = tuple(s.label for s in SENSORS if s.need is Need.REQUIRED)
OPTIONAL: Final = tuple(s.label for s in SENSORS if s.need is Need.OPTIONAL)
READ: Final = tuple(signal.label for signal in Signal)
"""Names of all that is read of a valve, in the order of the numbers."""
PUBLISHED: Final = (*REQUIRED, "dp", *OPTIONAL)
"""Names of what is published of the newest sample."""

IN_DIFFERENCE: Final = ("p1", "p2")
"""Names of the signals that one transmitter of ``dp`` may replace."""

COUNT: Final = len(SENSORS)
PER_VALVE: Final = len(Signal)
IS_OPTIONAL: Final = tuple(signal.need is Need.OPTIONAL for signal in SENSORS)

if TYPE_CHECKING:
    Measured = str
else:
    Measured = Literal[MEASURED]
