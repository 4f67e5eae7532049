"""The enumerations that are published, each member with a label and a sentence.

Nodes (EnumStrings and descriptions), the page and the documentation take their words from here.
"""

from enum import IntEnum
from typing import Final, Self


class Described(IntEnum):
    """An enumeration of (value, label, sentence).

    Attributes
    ----------
    label
        Short, for a table's cell.
    sentence
        For the operator.

    Examples
    --------
    >>> Status(1), Status(1).label
    (<Status.WARMING_UP: 1>, 'warming up')
    """

    label: str
    sentence: str

    def __new__(cls, value: int, label: str = "", sentence: str = "") -> Self:
        """Make a member."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.label, member.sentence = label, sentence
        return member


class Quality(IntEnum):
    """Quality of one sample; the quality gate decides."""

    GOOD = 0
    UNCERTAIN = 1
    BAD = 2


class Status(Described):
    """An estimator's use of one sample: numerical trouble is a value, not an exception."""

    OK = 0, "ok", "The sample was used and the parameters are determined."
    WARMING_UP = (
        1,
        "warming up",
        (
            "The samples do not yet determine all parameters, or the map does not yet predict "
            "the flow better than the mean of the measured flows does. Move U over its range and "
            "change the pressure drop; SuggestedU and SuggestedDp are the best next test point."
        ),
    )
    UNEXCITED = (
        2,
        "not excited",
        (
            "U, p1 and p2 vary too little to update all parameters; those without information keep "
            "their values. This is normal while the valve is at rest. Move U and the pressure drop "
            "to learn more."
        ),
    )
    REJECTED = (
        3,
        "rejected",
        (
            "The sample was refused and nothing was learnt from it: its status is Bad, a value is "
            "not a number or out of range, constant for too long, too fast, or a spike. The "
            "counter in Diagnostics that counts up names the reason."
        ),
    )
    FROZEN = (
        4,
        "frozen",
        "Freeze was called: the flow was predicted, nothing was learnt. Resume continues.",
    )
    HELD = (
        5,
        "held",
        (
            "The update would have made numbers too large to compute with: the sample was not "
            "learnt, and the parameters are unchanged. If it persists, Reset the estimator."
        ),
    )
    EXTRAPOLATING = (
        6,
        "extrapolating",
        (
            "Of Predict: nothing was measured near this point. Of a sample: U or the pressure drop "
            "is outside the range of the estimator's structure; the sample was not learnt."
        ),
    )
    FAILED = (
        7,
        "failed",
        (
            "The estimator stopped at an unexpected error; its last state is kept. Reset starts it "
            "again; the alarm LaneFailed names the reason."
        ),
    )
    UNRELIABLE = (
        8,
        "unreliable",
        (
            "The sample was used, but at places visited again the flow was outside the published "
            "95 % interval too often, also after the interval was widened as far as is allowed. Do "
            "not rely on the map's intervals; compare Findings and the other estimators."
        ),
    )


class Adaptation(Described):
    """An estimator's explanation of its residuals, and the memory that follows from it.

    A residual that comes back at the same place (U, dp) is misfit; one that moves with time is
    drift; before a place has been seen again the two cannot be distinguished. A residual that
    follows the news in U is neither.

    Examples
    --------
    >>> Adaptation.MISFIT.sentence
    'Residuals come back at the same places: the structure does not fit; the memory is kept.'
    """

    STEADY = 0, "steady", "Residuals are noise; the memory is long."
    UNDECIDED = (
        1,
        "undecided",
        (
            "Misfit and drift cannot be distinguished: too few places were visited again, or the "
            "estimator does not distinguish them; the memory is as configured."
        ),
    )
    MISFIT = (
        2,
        "misfit",
        "Residuals come back at the same places: the structure does not fit; the memory is kept.",
    )
    DRIFT = (
        3,
        "drift",
        (
            "Places seen again show another flow than before: the valve moves, and the memory is "
            "shortened to follow it."
        ),
    )
    REACTING = (
        4,
        "reacting",
        (
            "Changes of U from one sample to the next follow the residual: a controller moves U "
            "with the noise of the measured flow, or the measured U is noisy itself. This biases "
            "the map. Move U independently of the measured flow, e.g. in steps of the command."
        ),
    )


class InverseStatus(Described):
    """How far an inverse can be used; U is only ever given where it can."""

    OK = 0, "ok", "U delivers the demanded flow at this pressure drop."
    ABOVE_REACH = (
        1,
        "above reach",
        (
            "The valve cannot pass the demanded flow at this pressure drop; U = 100 %. Demand less "
            "flow, or provide a larger pressure drop."
        ),
    )
    BELOW_REACH = 2, "below reach", "Even the closed valve passes more than demanded; U = 0 %."
    NOT_MONOTONE = 3, "not monotone", "The map falls with U here; no U can be trusted."
    UNIDENTIFIED = 4, "unidentified", "The map is not identified here yet."
    NOT_FINITE = (
        5,
        "not a number",
        "The demand, the pressure drop or the temperature is not a number.",
    )
    OUTSIDE = (
        6,
        "outside",
        (
            "Only of an exported lookup table: the pressure drop is outside its range; U is that "
            "of the nearest end."
        ),
    )
    EXTRAPOLATING = (
        7,
        "extrapolating",
        "Nothing was measured near this U, pressure drop and temperature; U is a guess.",
    )
    UNCERTAIN = (
        8,
        "uncertain",
        (
            "U is the best answer now, but its flow is not known well: it may differ from the "
            "demand by more than three standard deviations of the flow meter's noise, and by more "
            "than 0.5 % of the largest flow."
        ),
    )


DELIVERS: Final = InverseStatus.OK, InverseStatus.UNCERTAIN
"""Statuses of an answer whose U the map says to deliver the demand, however well that is known."""


class AxisStatus(Described):
    """Whether the edges of a cylinder's valve can be identified from its position and pressures."""

    OK = 0, "ok", "The edges, the bulk modulus and the leakage are identified."
    NO_PRESSURES = (
        1,
        "no pressures",
        (
            "Position and command do not tell the flows: the same command gives another speed at "
            "another load. Add pA, pB, pS and pT."
        ),
    )
    MISSING_PRESSURE = (
        2,
        "pressure missing",
        "Each edge needs the pressures on both its sides. Add the missing one.",
    )
    MISSING_SIGNAL = (
        3,
        "signal missing",
        "Position (or speed) and U are both needed. Add the missing one.",
    )
    TOO_SLOW = (
        4,
        "too slow",
        (
            "The samples come too slowly for pressures and spool to be followed. Sample at 50 Hz "
            "or faster; 100 Hz is better."
        ),
    )
    TOO_SHORT = (
        5,
        "too short",
        "Less than 60 s can be used. Let the machine work for 5 minutes at several loads.",
    )
    END_STOPS = (
        6,
        "at the end stops",
        "The piston is at its end stops most of the time, where its speed tells no flow.",
    )
    LOW_PRESSURE = (
        7,
        "low pressure",
        (
            "A line is below 3 bar most of the time, where oil holds free air and may cavitate. "
            "Raise the back pressure or move against a load."
        ),
    )
    BULK_MODULUS = (
        8,
        "bulk modulus implausible",
        (
            "The bulk modulus is outside 0.1 … 2 GPa. Check units and sign of position and "
            "pressures, diameters and dead volumes."
        ),
    )
    UNEXCITED = (
        9,
        "not excited",
        "U does not open all edges. Move the axis in both directions.",
    )
    FAILED = (
        10,
        "failed",
        "An error stopped the identification of this axis; the log has it. A restart starts it.",
    )
    SIGNAL_INCONSISTENT = (
        11,
        "inconsistent signal",
        (
            "One signal does not fit the others, and the edges would be wrong by it. Check its "
            "zero, its noise, and whether it is delayed by a filter."
        ),
    )


class LineEdge(Described):
    """Which edge of a line passes a demanded flow."""

    NONE = 0, "none", "No flow is demanded, or the edge that would pass it is not learnt."
    PA = 1, "P to A", "U > 0 opens it: oil flows from P into line A."
    AT = 2, "A to T", "U < 0 opens it: oil flows from line A to the tank."
    PB = 3, "P to B", "U < 0 opens it: oil flows from P into line B."
    BT = 4, "B to T", "U > 0 opens it: oil flows from line B to the tank."
