"""Whether the measured U follows its commands, by the samples' own times. Pure."""

import math
from dataclasses import dataclass, replace
from typing import Final

MOST: Final = 512  # commands kept
KNOWN_TRAVEL: Final = 0.5  # share of the range of U
LEAST_DELAY_S: Final = 0.05  # s; a step of the run, and a sample
STEP_BACK_NS: Final = 1_000_000_000  # ns; of the source's clock, beyond the order of samples


@dataclass(frozen=True)
class Commands:
    """The newest commands, and when the newest sample was taken.

    The source's clock is not ours. A sample was taken at ``t - offset`` of our clock at the latest,
    where ``offset`` is the largest difference ``t - now`` at an arrival: that of the sample that
    was delivered quickest. Samples that come late and in bunches are so compared with the commands
    from their own time on. Those until their arrival count, too: a source that is late with its
    measurements stamps them with the times at which they were due.

    Attributes
    ----------
    writes
        Times of writing and of the response (s, monotonic), and U (%), of each command.
    t
        Time of the newest sample, ns by the source's clock.
    offset
        Of the source's clock to ours, s; -inf: no sample came.
    late_s, delay_s, travel
        Delay of U now and the longest one that is over, s; the way of the commands so far, %.

    Examples
    --------
    >>> commands = Commands().heard(1_000_000_000, 5.0).wrote(5.0, 5.01, 20.0)
    >>> commands = commands.wrote(5.2, 5.21, 30.0).heard(1_100_000_000, 5.4)  # 0.3 s late
    >>> [commands.are_followed(U, 0.05, 3.0) for U in (15.0, 20.0, 30.0)]
    [False, True, True]
    """

    writes: tuple[tuple[float, float, float], ...] = ()
    t: int = -(2**63)
    offset: float = -math.inf
    late_s: float = 0.0
    delay_s: float = 0.0
    travel: float = 0.0

    @property
    def taken(self) -> float:
        """When the newest sample was taken, by our clock, at the latest, s."""
        return 1e-9 * self.t - self.offset

    def wrote(self, at: float, answered: float, U: float) -> "Commands":
        """Return it with a command that came into force between two times."""
        travel = self.travel + (abs(U - self.writes[-1][2]) if self.writes else 0.0)
        return replace(self, writes=(*self.writes[1 - MOST :], (at, answered, U)), travel=travel)

    def heard(self, t: int, now: float) -> "Commands":
        """Return it with a sample that came at ``now``."""
        offset = 1e-9 * t - now
        if t >= self.t - STEP_BACK_NS:
            offset = max(offset, self.offset)
        return replace(self, t=t, offset=offset)

    def showed(self, U: float, percent: float) -> "Commands":
        """Return it with U (%) of the newest sample.

        Its delay behind the commands grows while it stands, and counts once U has moved on.
        """
        low, high, replaced = math.inf, -math.inf, math.inf
        for _, answered, command in self.writes[::-1]:
            low, high = min(low, command), max(high, command)
            if low - percent <= U <= high + percent:
                late_s = max(self.taken - replaced, 0.0)
                longest = max(self.delay_s, self.late_s) if late_s < self.late_s else self.delay_s
                return replace(self, late_s=late_s, delay_s=longest)
            replaced = answered
        return replace(self, late_s=0.0)

    def begun_anew(self) -> "Commands":
        """Return it without commands; delays and the clock stay known."""
        return replace(self, writes=(), late_s=0.0)

    def usual_s(self, follow_s: float, span: float) -> float:
        """Delay (s) beyond which U is unusually late: twice the longest; ``follow_s`` at first.

        It is known once the commands have travelled a share of ``span`` (%).
        """
        known = self.travel >= KNOWN_TRAVEL * span
        return min(max(2.0 * self.delay_s, LEAST_DELAY_S), follow_s) if known else follow_s

    def since(self, follow_s: float) -> "Commands":
        """Return it without commands that were replaced ``follow_s`` before the newest sample."""
        begin = self.taken - follow_s
        older = sum(answered < begin for _, answered, _ in self.writes)
        return replace(self, writes=self.writes[max(older - 1, 0) :])  # one from before stays

    def are_followed(self, U: float, follow_s: float, percent: float) -> bool:
        """Whether U (%) is near a command since ``follow_s`` before the newest sample.

        It is, too, as long as no command is that old.
        """
        if not self.writes or self.taken - self.writes[0][1] < follow_s:
            return True
        near = [U for _, _, U in self.since(follow_s).writes]
        return min(near) - percent <= U <= max(near) + percent
