"""The quantities of a valve's dynamics, one row a quantity.

Nodes, the command's table and its file are made from these rows. A new quantity is a row here and a
field of `Dynamics` (``model/dynamics.py``).
"""

from dataclasses import dataclass
from typing import Final

from valvemap.vocabulary.statuses import Described


class DynamicsStatus(Described):
    """How the dynamics of a valve stand.

    Examples
    --------
    >>> DynamicsStatus.TOO_SLOW.label
    'too slow'
    """

    OK = 0, "ok", "The dynamics are determined."
    WAITING = 1, "waiting", "A minute of samples without a gap is gathered first."
    TOO_SLOW = 2, "too slow", "Samples come too seldom to show a spool: 100 Hz are needed."
    UNEXCITED = (
        3,
        "not excited",
        (
            "U moves too little, too seldom or too slowly for the spool to lag: steps, PRBS or "
            "quicker machine work are needed."
        ),
    )
    FAILED = 4, "failed", "The fit ended at an unexpected error; the next samples start it again."


@dataclass(frozen=True)
class DynamicQuantity:
    """One quantity.

    Attributes
    ----------
    name
        Last segment of the NodeId ``s=<Valve>.Dynamics.<name>``.
    field
        The field of `Dynamics`.
    unit
        As in `Unit`; ``%/s`` has none there.
    range
        In that unit.
    sentence
        For nodes and the documentation.
    """

    name: str
    field: str
    unit: str
    range: tuple[float, float]
    sentence: str

    @property
    def in_words(self) -> tuple[str, float]:
        """The unit in which people read it, and the factor to it: times in ms."""
        return ("ms", 1e3) if self.unit == "s" else (self.unit, 1.0)


DYNAMIC_QUANTITIES: Final = (
    DynamicQuantity(
        "NaturalFrequency",
        "natural_frequency",
        "Hz",
        (0.0, 200.0),
        "Natural frequency of the spool, as one of second order.",
    ),
    DynamicQuantity("Damping", "damping", "1", (0.0, 5.0), "Damping ratio of the spool."),
    DynamicQuantity("Slew", "slew", "%/s", (0.0, 1e6), "Largest speed of the spool."),
    DynamicQuantity("DeadTime", "dead_time", "s", (-1.0, 1.0), "Time until the spool follows U."),
    DynamicQuantity("MeterLag", "meter_lag", "s", (0.0, 1.0), "Time constant of the flow meter."),
    DynamicQuantity(
        "T90",
        "T90",
        "s",
        (0.0, 10.0),
        "Time from the largest step of U seen to 90 % of the spool's travel, with dead time and "
        "without the meter.",
    ),
)
"""In the order of nodes and tables."""
