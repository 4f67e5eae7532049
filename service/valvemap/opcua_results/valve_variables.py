"""The variables of a valve beside its estimators and maps: diagnostics, alarms, recommendation."""

from asyncua import ua

from guarded_opcua import Unit
from valvemap.opcua_results.information_model import (
    ARMED,
    BASELINE,
    DIAGNOSTICS,
    FEED_FORWARD_STATUS,
    FINDING_CODES,
    FINDING_PROBABILITIES,
    FINDINGS,
    LAST_ACTION,
    PENDING,
    RECOMMENDED,
    RECOMMENDED_REASON,
    SAMPLE_AGE,
    TIMING,
    WAITING,
    YEAR_S,
    VariableNode,
    sentences_of,
)
from valvemap.pipeline.alignment import COUNTER_NAMES as OF_ALIGNMENT
from valvemap.pipeline.quality_gate import COUNTER_NAMES as OF_GATE
from valvemap.pipeline.results import ValveDescription
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.findings import FindingCode


def recommended_variables(valve: str) -> tuple[VariableNode, VariableNode]:
    """The variables that name the estimator to use, and say why."""
    return (
        VariableNode(
            f"{valve}.{RECOMMENDED}",
            "Name of the estimator whose map has the least error at places that the valve visited "
            "again; empty while there is none.",
            ua.VariantType.String,
        ),
        VariableNode(
            f"{valve}.{RECOMMENDED_REASON}",
            "Why it is recommended, how sure that is, and what would improve the map.",
            ua.VariantType.String,
        ),
    )


def arming_variables(prefix: str) -> tuple[VariableNode, VariableNode]:
    """The variables of feed-forward, of a valve's or an axis's inverse."""
    return (
        VariableNode(
            f"{prefix}.{ARMED}",
            "Whether writing RequiredU to the valve is armed; see Arm and Disarm.",
            ua.VariantType.Boolean,
        ),
        VariableNode(
            f"{prefix}.{FEED_FORWARD_STATUS}",
            "Whether RequiredU is written to the valve, and the first reason if not. With reasons "
            "1 to 3 nothing is written. With 4 to 12 feed_forward.fallback applies: hold the "
            "last U, ramp to fallback_percent, or hand the valve back to the source. "
            f"{sentences_of(FeedForwardStatus)}",
            ua.VariantType.Int32,
            statuses=FeedForwardStatus,
        ),
    )


def finding_variables(valve: str) -> tuple[VariableNode, VariableNode, VariableNode]:
    """The variables with the causes that explain a valve's samples, the likeliest first."""
    return (
        VariableNode(
            f"{valve}.{FINDINGS}",
            "Causes that explain the valve's samples, a sentence each, the likeliest first.",
            ua.VariantType.String,
            dimensions=(0,),
        ),
        VariableNode(
            f"{valve}.{FINDING_CODES}",
            f"The cause of each of Findings. {sentences_of(FindingCode)}",
            ua.VariantType.Int32,
            dimensions=(0,),
            statuses=FindingCode,
        ),
        VariableNode(
            f"{valve}.{FINDING_PROBABILITIES}",
            "The probability of each of Findings.",
            range=(0.0, 1.0),
            dimensions=(0,),
        ),
    )


def waiting_variable(valve: str) -> VariableNode:
    """The variable that explains why no samples are made of a valve's signals, or none are used."""
    return VariableNode(
        f"{valve}.{WAITING}",
        "Reason why no samples are made of the valve's signals or none are learnt: a sentence "
        'for each signal at fault, with the setting that would help, e.g. that p2 "has sent no '
        'value: is nodes.p2 the right node?". Empty if samples are learnt.',
        ua.VariantType.String,
        dimensions=(0,),
    )


def timing_variable(valve: str) -> VariableNode:
    """The variable that describes the timing of a valve's signals."""
    return VariableNode(
        f"{valve}.{TIMING}",
        "Timing of each signal, found at the start: a common time, one after the other in a scan, "
        "or on change. A U that comes to rest later is on change from then on.",
        ua.VariantType.String,
        dimensions=(0,),
    )


def alarm_variables(prefix: str) -> tuple[VariableNode, ...]:
    """The variables of one alarm; ``prefix`` is the identifier of its object."""
    return (
        VariableNode(
            f"{prefix}.Active",
            "Whether the alarm is active; its SourceTimestamp is the time of the last change.",
            ua.VariantType.Boolean,
        ),
        VariableNode(
            f"{prefix}.Severity",
            "Severity of the alarm while it is active, 1 to 1,000, as configured.",
            ua.VariantType.UInt16,
        ),
        VariableNode(
            f"{prefix}.Since",
            "Source time since which the measured value was beyond its limit when the alarm was "
            "last raised.",
            ua.VariantType.DateTime,
        ),
        VariableNode(
            f"{prefix}.Text",
            "Measured value, time of onset and possible cause; empty before the first occurrence.",
            ua.VariantType.String,
        ),
        VariableNode(
            f"{prefix}.Acked",
            "Whether the alarm was acknowledged since it last became active; true before the "
            "first occurrence.",
            ua.VariantType.Boolean,
        ),
        VariableNode(
            f"{prefix}.Confirmed",
            "False while an acknowledged alarm waits for Confirm; else true, also for an alarm "
            "that was never active or is not yet acknowledged.",
            ua.VariantType.Boolean,
        ),
    )


def baseline_variables(valve: str) -> tuple[VariableNode, ...]:
    """The variables of the baseline, the map that was approved as new."""
    prefix = f"{valve}.{BASELINE}"
    return (
        VariableNode(
            f"{prefix}.Version",
            "The approved map: its number and the first digits of its hash; empty if there is "
            "none.",
            ua.VariantType.String,
        ),
        VariableNode(f"{prefix}.Time", "Time of the newest sample in it.", ua.VariantType.DateTime),
        VariableNode(
            f"{prefix}.DataHash", "SHA-256 of the approved map's content.", ua.VariantType.String
        ),
        VariableNode(
            f"{prefix}.LastRefusal",
            "Reason for the last refused action; empty if none was refused.",
            ua.VariantType.String,
        ),
    )


def last_action(valve: ValveDescription) -> VariableNode:
    """The variable with the last action on a valve."""
    return VariableNode(
        f"{valve.name}.{LAST_ACTION}",
        "Last action of a user on this valve: user, colon, method or demand. Its "
        "SourceTimestamp is the time of the action.",
        ua.VariantType.String,
    )


def counter_name(counter: str) -> str:
    """Name of a counter's variable within its valve, from its name in snake case.

    >>> counter_name("bad_status")
    'Diagnostics.BadStatus'
    """
    return f"{DIAGNOSTICS}.{_camel_case(counter)}"


def counter_variable(valve: str, counter: str) -> VariableNode:
    """The variable of one counter of a valve."""
    meaning = COUNTERS.get(counter, f"{counter.replace('_', ' ').capitalize()}.")
    since = "A restart keeps it." if counter in _KEPT else "Counted since the service started."
    return VariableNode(
        f"{valve}.{counter_name(counter)}",
        f"{meaning} {since}",
        ua.VariantType.UInt64,
    )


def health_variables(valve: str) -> tuple[VariableNode, VariableNode]:
    """Freshness of a valve's data: the age of the newest sample and the pending samples."""
    return (
        VariableNode(
            f"{valve}.{SAMPLE_AGE}",
            "Age of the newest sample by the source's clock; it grows while no sample arrives. "
            "Beyond alignment.stale_after_s results are no longer Good.",
            unit=Unit.SECOND,
            range=(0.0, YEAR_S),
        ),
        VariableNode(
            f"{valve}.{PENDING}",
            "Samples waiting for a missing signal or for earlier samples.",
            ua.VariantType.UInt64,
        ),
    )


def _camel_case(name: str) -> str:
    return "".join(part[:1].upper() + part[1:] for part in name.split("_"))


_KEPT = {*OF_ALIGNMENT, *OF_GATE, "lane_failures"}  # part of the checkpoint


COUNTERS = {
    "aligned": "Samples whose signals were aligned.",
    "late": "Signals received after their sample had been dropped.",
    "missing": "Samples dropped because a signal was missing.",
    "duplicates": "Signals received twice for one sample.",
    "clock_steps": "Jumps of the source's clock backwards.",
    "lost_by_time": "Samples lost according to the usual sampling interval, where the source "
    "has no Sequence.",
    "restarts": "Restarts of the source's Sequence, its running number of samples.",
    "gaps": "Samples lost according to the source's Sequence, its running number of samples.",
    "bad_status": "Samples rejected for their OPC UA status.",
    "not_finite": "Samples rejected for a value that is not finite.",
    "out_of_range": "Samples rejected for a value outside the sensor's range.",
    "frozen": "Samples rejected because a signal was constant for too long.",
    "too_fast": "Samples rejected because a signal changed faster than its limit.",
    "spike": "Samples rejected because a signal had a spike.",
    "beyond_range": "Samples not learnt by an estimator: U or Δp is outside the range of its map.",
    "censored": "Samples not learnt by Auto: the meter does not show a flow as large or as small.",
    "lane_failures": "Stops of an estimator at an unexpected error (alarm LaneFailed).",
}
