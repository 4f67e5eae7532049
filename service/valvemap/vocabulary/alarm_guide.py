"""For an operator: the quantity of each alarm, its unit, and what to do. Pure.

The page shows it. The documentation's table of alarms is made from it, with the limits of
:mod:`pipeline.alarms` and the causes of :mod:`pipeline.alarm_words`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Guide:
    """Guidance on one alarm.

    Attributes
    ----------
    quantity
        The measured quantity that is compared with the limit.
    unit
        Of the limit as it is configured; empty for a plain number.
    action
        For the operator.
    """

    quantity: str
    unit: str
    action: str


GUIDES: Final[Mapping[str, Guide]] = {
    "Changed": Guide(
        "size of an abrupt change of flow, found by an estimator",
        "% of the flow's range",
        "Check the flow meter and the pressure sensors against others, then the valve. Acknowledge "
        "(this ends the alarm). If the valve was replaced, call Baseline.ValveReplaced.",
    ),
    "Residual": Guide(
        "averaged residuals, relative to their usual size at the same U and pressure drop",
        "times the usual",
        "Check the causes named in Text, the oil's temperature first. The alarm ends when the "
        "residuals are as usual again, e.g. once the map has followed the valve.",
    ),
    "Misfit": Guide(
        "ResidualRmse, or the error at places visited again if that is larger, while Adaptation "
        "is MISFIT; else 0",
        "% of the flow's range",
        "Use the estimator that Recommended names, e.g. Auto, which chooses its structure. Check "
        "the offsets of U, p1 and p2. The interval of PredictMeasurement includes the misfit.",
    ),
    "SensorLost": Guide(
        "time without a usable sample",
        "s",
        "See Diagnostics.Waiting for the signal at fault and Service.Source.States for the "
        "connection; restore the sensor, its cable or the source. It ends with the next usable "
        "sample.",
    ),
    "SensorFrozen": Guide(
        "time for which a signal other than U is constant to the last digit while others vary",
        "s",
        "Check the named sensor, its cable, and whether the source repeats its last value. It ends "
        "when the value varies.",
    ),
    "Unexcited": Guide(
        "time for which every sample was UNEXCITED",
        "s",
        "None if the machine is at rest. To improve the map, move U and the pressure drop to "
        "SuggestedU and SuggestedDp.",
    ),
    "Extrapolated": Guide(
        "1 while the answer to the demand is extrapolated, else 0",
        "",
        "Do not rely on RequiredU; feed-forward does not write it. Demand a measured point, or "
        "measure near this one.",
    ),
    "SamplesLost": Guide(
        "share of samples lost within about a minute",
        "%",
        "Lengthen the source's queue or its sampling interval; check the network. "
        "Diagnostics.Gaps and LostByTime count the losses.",
    ),
    "LagFound": Guide(
        "largest lag of a signal, as estimated by Auto",
        "s",
        "None if the valve or the meter is known to be slow: Auto corrects for the lag. Else check "
        "the meter's filter and the source's time stamps.",
    ),
    "LaneFailed": Guide(
        "number of the valve's estimators that stopped at an unexpected error",
        "",
        "Report the error in Text and the log's traceback. Call Reset of the estimator; if all "
        "stopped, Reset of one restarts all.",
    ),
    "Checkpoint": Guide(
        "time since the last checkpoint; the limit is at least 3 checkpoint intervals",
        "s",
        "Free space on the disk or restore the rights to the state file: after a crash of "
        "the service, all that was learnt since the last checkpoint would be lost, unless the "
        "source resends it.",
    ),
    "Certificate": Guide(
        "remaining validity of the service's certificate; the alarm is raised below the limit",
        "days",
        "Renew the certificate before it expires: clients refuse an expired one.",
    ),
    "Load": Guide(
        "share of time in which the service is busy; 1 if results are too late to be Good",
        "",
        "Serve fewer valves or estimators, lower the sampling rate, or provide a faster machine.",
    ),
    "History": Guide(
        "time for which rows of the history wait to be saved; also raised when rows were lost",
        "s",
        "Free space on the disk, or restore the rights to the history's file. Rows are lost when "
        "the buffer is full (Service.History.Lost). Estimation is not affected.",
    ),
    "EdgeChanged": Guide(
        "probability that an edge has changed, of the likeliest one",
        "",
        "See Diagnostics.Findings for the edge and the size. Check the pressure sensors at its "
        "ports, then the valve. After a repair, call Diagnostics.SetReference.",
    ),
    "LeakageChanged": Guide(
        "probability that the leakage between the lines has changed",
        "",
        "Check the piston's seal and what connects both lines. After a repair, call "
        "Diagnostics.SetReference.",
    ),
    "AirChanged": Guide(
        "probability that air or stiffness of the oil have changed",
        "",
        "Vent the lines; check the oil's level and the suction line. Then call "
        "Diagnostics.SetReference.",
    ),
    "FrictionChanged": Guide(
        "probability that the cylinder's dry friction has changed",
        "",
        "Check the seals of piston and rod, the guides and their lubrication. Then call "
        "Diagnostics.SetReference.",
    ),
    "AxisMisfit": Guide(
        "probability that something else has changed",
        "",
        "Check the sensors of position and pressures, their time stamps, play and friction of the "
        "spool. Then call Diagnostics.SetReference.",
    ),
    "AxisSilent": Guide(
        "time without a sample of the axis",
        "s",
        "See Service.Source.States for the connection; restore the sensor, its cable or the "
        "source. It ends with the next sample.",
    ),
    "AxisFailed": Guide(
        "1 once the axis has stopped, else 0",
        "",
        "Report the error in Text and the log's traceback, then restart the service.",
    ),
    "MessagesRejected": Guide(
        "messages and states of a fleet that were rejected since the last serve.rejected_quiet_s "
        "without any",
        "",
        "Find the sender by the reason in Text and the log; bring it to the same version and "
        "catalogue.",
    ),
}
