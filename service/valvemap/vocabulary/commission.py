"""The phases of a commissioning run."""

from valvemap.vocabulary.statuses import Described


class Phase(Described):
    """State of a commissioning run.

    Examples
    --------
    >>> Phase.SWEEPING.sentence
    'crossing triangles'
    """

    IDLE = 0, "idle", "not started"
    CHECKING = 1, "checking", "checks signals before the first command"
    SWEEPING = 2, "sweeping", "crossing triangles"
    REFINING = 3, "refining", "visits points where the map is least certain"
    PAUSED = 4, "paused", "paused: safe U, or handed back"
    RETURNING = 5, "returning", "returns to the safe U"
    DONE = 6, "done", "done"
    ABORTED = 7, "aborted", "aborted"
    REFUSED = 8, "refused", "refused before the first command"

    @property
    def is_over(self) -> bool:
        """Whether nothing more is written."""
        return self in {Phase.DONE, Phase.ABORTED, Phase.REFUSED}
