"""Causes that explain the samples of a valve, each with a code, a label and a sentence."""

from dataclasses import dataclass

from valvemap.vocabulary.statuses import Described


class FindingCode(Described):
    """A cause that an estimator weighs.

    Examples
    --------
    >>> FindingCode.PLAY.label
    'play'
    """

    GAIN_DRIFT = 0, "gain drifts", "The flow at all openings rises or falls steadily."
    EDGE_DRIFT = 1, "edge drifts", "The metering edge moves steadily: overlap grows or wears."
    GAIN_CHANGE = 2, "gain changed", "The flow at all openings changed suddenly."
    EDGE_CHANGE = 3, "edge changed", "The metering edge moved suddenly."
    PLAY = 4, "play", "The spool has play: after U turns, it moves only once U has passed the play."
    HYSTERESIS = 5, "hysteresis", "The flow depends on the path of U, as with friction."
    LAG_U = 6, "spool lags", "The spool follows U with a first-order lag."
    LAG_Q = 7, "meter lags", "The flow meter follows the flow with a first-order lag."
    DEAD_TIME = 8, "dead time", "The measured flow follows U after a dead time."
    AVERAGING = 9, "meter averages", "The flow meter shows a moving average."
    METER_END = 10, "meter at its end", "The flow meter does not show flows above its end."
    METER_START = 11, "meter starts late", "The flow meter shows no flow below its least flow."
    CHOKING = 12, "choking", "At a low p2 the flow depends on p1 alone."
    COMPENSATOR = 13, "compensator", "Above a pressure drop the flow does not rise with it."
    PUMP_LIMIT = 14, "pump at its limit", "The pump does not deliver more than a largest flow."
    REACTING_U = 15, "reacting control", "U reacts to the noise of the flow in the same sample."
    MISFIT = (
        16,
        "misfit",
        "The samples contradict the map, and none of the other causes explains it.",
    )
    DYNAMICS_CHANGE = (
        17,
        "dynamics changed",
        "The spool has become slower or quicker than it was.",
    )
    PA_CHANGE = 18, "edge pa changed", "The edge PA passes more or less flow than it did."
    AT_CHANGE = 19, "edge at changed", "The edge AT passes more or less flow than it did."
    PB_CHANGE = 20, "edge pb changed", "The edge PB passes more or less flow than it did."
    BT_CHANGE = 21, "edge bt changed", "The edge BT passes more or less flow than it did."
    LEAKAGE_CHANGE = 22, "leakage changed", "More or less oil leaks between the lines than did."
    AIR = 23, "air", "Oil and hoses are softer or stiffer than they were: the oil's air changed."

    WEAR = 24, "part of edge wears", "The flow at some openings rises or falls steadily."
    FRICTION = (
        25,
        "friction changed",
        "The piston moves with more or less dry friction than it did.",
    )
    FLOW_ZERO = 26, "meter's zero moved", "The flow meter shows an offset that it did not have."
    PRESSURE_ZERO = 27, "pressures' zero moved", "p1 - p2 has an offset that it did not have."


@dataclass(frozen=True)
class Finding:
    """One cause, found for one valve.

    Attributes
    ----------
    code
        The cause.
    probability
        That it is present, 0 … 1.
    sentence
        For the operator, with sizes and rates.
    """

    code: FindingCode
    probability: float
    sentence: str
