"""Requests for commissioning runs of the service, and their published results."""

import math
from dataclasses import dataclass
from typing import Protocol

from valvemap.vocabulary.commission import Phase


@dataclass(frozen=True)
class CommissionResults:
    """How the run of one valve stands.

    ``progress`` is a line of words; ``time_left`` in s at most; ``map_std`` (l/min) is the standard
    deviation of the map, mean over U, NaN before the first fit; ``recording`` the file's path.
    """

    phase: Phase = Phase.IDLE
    reason: str = ""
    progress: str = Phase.IDLE.sentence
    time_left: float = math.nan
    map_std: float = math.nan
    recording: str = ""


class CommissionOperator(Protocol):
    """Carries out the commands of an operator on commissioning runs."""

    def start_commission(self, valve: str, accuracy: float, user: str) -> None:
        """Start a run that ends at a 95 % interval of ± ``accuracy`` l/min; 0: at its full time.

        Raises
        ------
        CommandRejected
            if one is under way, or feed-forward is armed.
        """

    def resume_commission(self, valve: str, accuracy: float, user: str) -> None:
        """Learn the samples of the last run, and continue it where it was interrupted.

        Raises
        ------
        CommandRejected
            as `start_commission`, or if there is no run, or it was complete.
        """

    def abort_commission(self, valve: str) -> None:
        """Let a run return to its safe U, and end."""

    def note_operator(self, valve: str) -> None:
        """Note a sign of the operator: a run without one ends."""


class CommissionSink(Protocol):
    """Shows runs."""

    def show_commission(self, valve: str, results: CommissionResults) -> None:
        """Show how the run of one valve stands."""
