"""The external control signal, the load's set point, and their watchdog; no I/O.

While ``Heartbeat`` is 0, ``UCommand`` and ``LoadCommand`` are applied as written (manual
operation). After the first heartbeat, the client must keep changing it. If it does not change for
`STANDSTILL_S`, or returns to 0, the commands are dropped and the rig's own apply. After a time-out,
the client resumes by changing the heartbeat or writing 0. A machine's command is added to that of
its controller: once dropped, it returns to 0 within a slew.
"""

from dataclasses import dataclass, replace
from typing import Final, Self

STANDSTILL_S: Final = 0.45  # s; with the time until it is noticed, U is safe within .5 s
RETURN_PERCENT_PER_S: Final = 2_000.0  # %/s; from 100 % to 0 within the remaining .05 s


@dataclass(frozen=True)
class Command:
    """State of the external commands, None while the rig's own apply: ``U`` (%), ``load`` (bar).

    ``heartbeat`` is the last one written, ``moved_s`` the time of its last change; ``dropped``: the
    watchdog has timed out.

    Examples
    --------
    >>> command = Command().written(40.0).beaten(1, now=0.0).seen(now=0.4)
    >>> command.in_force
    40.0
    >>> print(command.seen(now=0.46).in_force)
    None
    """

    U: float | None = None
    load: float | None = None
    heartbeat: int = 0
    moved_s: float = 0.0
    dropped: bool = False

    @property
    def in_force(self) -> float | None:
        """The external control signal (%), None for the rig's default."""
        return None if self.dropped else self.U

    @property
    def load_in_force(self) -> float | None:
        """The external set point of the load (bar), None for the rig's own."""
        return None if self.dropped else self.load

    def written(self, U: float) -> Self:
        """Return the state after a control signal (%) was written."""
        return replace(self, U=U)

    def loaded(self, load: float) -> Self:
        """Return the state after a set point of the load (bar) was written."""
        return replace(self, load=load)

    def beaten(self, heartbeat: int, now: float) -> Self:
        """Return the state after a heartbeat was written at ``now`` (s)."""
        if heartbeat == 0 and self.heartbeat != 0:
            return type(self)()
        if heartbeat == self.heartbeat:
            return self
        return replace(self.seen(now), heartbeat=heartbeat, moved_s=now, dropped=False)

    def seen(self, now: float) -> Self:
        """Return the state after a check of the watchdog at ``now`` (s)."""
        still = self.heartbeat != 0 and now - self.moved_s > STANDSTILL_S
        if not still or self.dropped:
            return self
        return replace(self, U=None, load=None, dropped=True)


def lead_of(command: Command, before: float, passed_s: float) -> float:
    """Return the lead added to the command of a machine's controller, %.

    ``before`` is the lead ``passed_s`` seconds ago.

    Examples
    --------
    >>> lead_of(Command(U=40.0), 10.0, 0.01), lead_of(Command(dropped=True), 50.0, 0.01)
    (40.0, 30.0)
    """
    if (U := command.in_force) is not None:
        return U
    step = RETURN_PERCENT_PER_S * passed_s
    return before - min(max(before, -step), step)
