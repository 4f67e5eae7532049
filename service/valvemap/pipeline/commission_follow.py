"""Whether the measured U follows its commands, by the samples' own times. Pure."""

import math
from dataclasses import dataclass, replace
from typing import Final

MOST: Final = 512  # commands kept
STEP_BACK_NS: Final = 1_000_000_000  # ns; of the source's clock, beyond the order of samples


@dataclass(frozen=True)
class Commands:
    """The newest commands, and when the newest sample was taken.

    The source's clock is not ours. A sample was taken at ``t - offset`` of our clock at the latest,
    where ``offset`` is the largest difference ``t - now`` at an arrival: that of the sample that
    was delivered quickest. Samples that come late and in bunches are so compared with the commands
    of their own time.

    Attributes
    ----------
    writes
        Times of writing and of the response (s, monotonic), and U (%), of each command.
    t
        Time of the newest sample, ns by the source's clock.
    offset
        Of the source's clock to ours, s; -inf: no sample came.

    Examples
    --------
    >>> commands = Commands().heard(1_000_000_000, 5.0).wrote(5.0, 5.01, 20.0)
    >>> commands = commands.wrote(5.2, 5.21, 30.0).heard(1_100_000_000, 5.4)  # 0.3 s late
    >>> [commands.are_followed(U, 0.05, 3.0) for U in (20.0, 30.0)]
    [True, False]
    """

    writes: tuple[tuple[float, float, float], ...] = ()
    t: int = -(2**63)
    offset: float = -math.inf

    @property
    def taken(self) -> float:
        """When the newest sample was taken, by our clock, at the latest, s."""
        return 1e-9 * self.t - self.offset

    def wrote(self, at: float, answered: float, U: float) -> "Commands":
        """Return it with a command that came into force between two times."""
        return replace(self, writes=(*self.writes[1 - MOST :], (at, answered, U)))

    def heard(self, t: int, now: float) -> "Commands":
        """Return it with a sample that came at ``now``."""
        offset = 1e-9 * t - now
        if t >= self.t - STEP_BACK_NS:
            offset = max(offset, self.offset)
        return replace(self, t=t, offset=offset)

    def since(self, follow_s: float) -> "Commands":
        """Return it without commands that were replaced ``follow_s`` before the newest sample."""
        begin = self.taken - follow_s
        older = sum(answered < begin for _, answered, _ in self.writes)
        return replace(self, writes=self.writes[max(older - 1, 0) :])  # one from before stays

    def are_followed(self, U: float, follow_s: float, percent: float) -> bool:
        """Whether U (%) is near a command of the last ``follow_s`` before the newest sample.

        Commands after it are none of its own. It is, too, as long as no command is that old.
        """
        taken = self.taken
        if not self.writes or taken - self.writes[0][1] < follow_s:
            return True
        near = [U for at, _, U in self.since(follow_s).writes if at <= taken]
        return min(near) - percent <= U <= max(near) + percent
