"""The variables of the service itself."""

from asyncua import ua

from guarded_opcua import Unit
from valvemap.opcua_results.information_model import SERVICE, YEAR_S, VariableNode


def service_variables() -> dict[str, tuple[VariableNode, ...]]:
    """The variables of the service itself, by part."""
    counts = ua.VariantType.UInt64
    return {
        f"{SERVICE}.Checkpoint": (
            VariableNode(
                f"{SERVICE}.Checkpoint.Age",
                "Time since the last save of the states.",
                unit=Unit.SECOND,
                range=(0.0, YEAR_S),
            ),
            VariableNode(
                f"{SERVICE}.Checkpoint.Failures",
                "Failed saves of states since the service started.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Checkpoint.Refused",
                "States rejected at the start: damaged, or of another configuration.",
                counts,
            ),
            VariableNode(f"{SERVICE}.Checkpoint.Size", "Size on disk, bytes.", counts),
        ),
        f"{SERVICE}.History": (
            VariableNode(
                f"{SERVICE}.History.Lost",
                "Rows of the history that were lost: the buffer was full or the disk refused them.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.History.Failures",
                "Failed writes of the history since the service started.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.History.Size", "Size on disk, bytes; 0 if there is no file.", counts
            ),
        ),
        f"{SERVICE}.Start": (
            VariableNode(
                f"{SERVICE}.Start.Text",
                "State of the start: compiling, with the parts done, or complete.",
                ua.VariantType.String,
            ),
            VariableNode(
                f"{SERVICE}.Start.Compiled",
                "Share of the numerical kernels that are compiled. Until 100 %, estimators that "
                "are too slow without them (Auto) wait; no sample is lost.",
                unit=Unit.PERCENT,
                range=(0.0, 100.0),
            ),
        ),
        f"{SERVICE}.Source": (
            VariableNode(
                f"{SERVICE}.Source.Notifications", "Value changes received from the source.", counts
            ),
            VariableNode(
                f"{SERVICE}.Source.Overflows",
                "Value changes marked Overflow: the source's queue was full and lost others.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Source.MissingMessages",
                "Messages lost: not received and not republished.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Source.Undecodable",
                "Value changes that are not numbers, and messages that cannot be decoded.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Source.FromHistory",
                "Value changes missed live and read from the source's history.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Source.States",
                "One line per source: connection and losses.",
                ua.VariantType.String,
                dimensions=(0,),
            ),
        ),
    }
