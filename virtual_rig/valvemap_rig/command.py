"""The control signal from outside, and whether it counts: the rig's own watchdog. Pure.

``UCommand`` is taken as written while ``Heartbeat`` is 0: by hand. Once a heartbeat is written it
has to move; when it stands still for `STANDSTILL_S`, or goes back to 0, the command is dropped and
the rig's own holds. From a standstill only a heartbeat that moves again, or 0, leads back.
"""

from dataclasses import dataclass, replace
from typing import Final, Self

STANDSTILL_S: Final = 0.5


@dataclass(frozen=True)
class Command:
    """What came from outside; ``U`` (%) is None while the rig's own command holds.

    ``heartbeat`` is the last one written, ``moved_s`` when it last changed; ``dropped`` says that
    it stood still too long.

    Examples
    --------
    >>> command = Command().written(40.0).beaten(1, now=0.0).seen(now=0.4)
    >>> command.in_force
    40.0
    >>> print(command.seen(now=0.51).in_force)
    None
    """

    U: float | None = None
    heartbeat: int = 0
    moved_s: float = 0.0
    dropped: bool = False

    @property
    def in_force(self) -> float | None:
        """The control signal (%), None for the rig's own."""
        return None if self.dropped else self.U

    def written(self, U: float) -> Self:
        """A control signal (%) was written."""
        return replace(self, U=U)

    def beaten(self, heartbeat: int, now: float) -> Self:
        """A heartbeat was written at ``now`` (s)."""
        if heartbeat == 0 and self.heartbeat != 0:
            return type(self)()
        if heartbeat == self.heartbeat:
            return self
        return replace(self.seen(now), heartbeat=heartbeat, moved_s=now, dropped=False)

    def seen(self, now: float) -> Self:
        """The rig looks at it at ``now`` (s)."""
        still = self.heartbeat != 0 and now - self.moved_s > STANDSTILL_S
        return replace(self, U=None, dropped=True) if still and not self.dropped else self
