"""How many changes are identified at once, so that other tasks run in between."""

BEHIND_S = 1.0  # s; a preview with a longer backlog takes no more samples until compilation ends
LEARN_S = 0.05  # s; target duration of one piece when a backlog is estimated
FEWEST_AT_ONCE = 600  # changes: 100 samples, 0.1 s if Auto fits all; smaller pieces cost more each
FIRST_AT_ONCE = 3_000  # changes; size of the first piece, before the pace is measured
QUICKER = 0.05  # weight of a piece that is quicker than the estimated pace: fits come in bursts


class LearningPace:
    """The estimated pace of identification, changes per second.

    Parameters
    ----------
    is_interpreted
        Whether kernels run interpreted at first.

    Examples
    --------
    >>> pace = LearningPace(is_interpreted=False)
    >>> pace.at_once
    3000
    >>> pace.note(3000, 0.1)
    >>> pace.at_once
    1500
    """

    def __init__(self, *, is_interpreted: bool) -> None:
        self.changes_per_s = (FEWEST_AT_ONCE if is_interpreted else FIRST_AT_ONCE) / LEARN_S

    @property
    def at_once(self) -> int:
        """Number of changes of the next piece."""
        return max(FEWEST_AT_ONCE, int(LEARN_S * self.changes_per_s))

    def falls_behind(self, changes: int) -> bool:
        """Whether this number of changes takes too long."""
        return changes > BEHIND_S * self.changes_per_s

    def note(self, changes: int, took_s: float) -> None:
        """Note the time that a number of changes took."""
        if changes >= FEWEST_AT_ONCE and took_s > 0.0:
            quicker = changes / took_s - self.changes_per_s
            self.changes_per_s += quicker * (QUICKER if quicker > 0.0 else 1.0)
