"""The columns of the history beside the signals, and which of them any row's code leaves Good."""

from typing import Final

from valvemap.vocabulary.quantities import HISTORY_QUANTITIES, Undetermined

REQUIRED_U: Final = "RequiredU"
REQUIRED_U_STATUS: Final = "RequiredUStatus"
OWN_WORDS: Final = frozenset(
    {
        REQUIRED_U_STATUS,
        *(q.name for q in HISTORY_QUANTITIES if q.undetermined is Undetermined.NEVER),
    }
)
"""What the service states of itself is Good whatever the sensors' state: statuses, for example."""
