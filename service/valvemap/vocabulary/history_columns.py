"""The columns of the history beside the signals, and which of them any row's code leaves Good."""

from typing import Final

from valvemap.vocabulary.axis_quantities import AXIS_QUANTITIES
from valvemap.vocabulary.edges import split_id
from valvemap.vocabulary.quantities import HISTORY_QUANTITIES, Undetermined

STATUS: Final = "Status"
REQUIRED_U: Final = "RequiredU"
REQUIRED_U_STATUS: Final = "RequiredUStatus"
OWN_WORDS: Final = frozenset(
    {
        REQUIRED_U_STATUS,
        *(q.name for q in HISTORY_QUANTITIES if q.undetermined is Undetermined.NEVER),
    }
)
"""What the service states of itself is Good whatever the sensors' state: statuses, for example."""
OF_AXES: Final = frozenset({STATUS, *(quantity.name for quantity in AXIS_QUANTITIES)})
"""Columns of an axis itself."""


def place_of(id_: str) -> tuple[str, str]:
    """Return the series and the column in which a variable's history is stored.

    The status of an axis is stored at each result, its quantities with each new map: a series each.

    >>> place_of("V1.Signals.Q"), place_of("Press.Leakage"), place_of("Press.Status")
    (('V1.Signals', 'Q'), ('Press', 'Leakage'), ('Press.Status', 'Status'))
    >>> place_of("V1.RLS.Status"), place_of("Boom.PA.RLS.Status")
    (('V1.RLS', 'Status'), ('Boom.PA.RLS', 'Status'))
    """
    owner, rest = split_id(id_)
    if rest == STATUS:
        return f"{owner}.{STATUS}", STATUS
    series, _, column = id_.rpartition(".")
    return series, column
