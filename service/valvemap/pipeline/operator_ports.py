"""Ports of a results server's clients: commands of operators, and questions to the maps."""

from collections.abc import Awaitable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, TypeVar

from valvemap.model.inversion import Inversion
from valvemap.pipeline.alarm_results import AlarmReport, Remark
from valvemap.pipeline.results import Compared, Version
from valvemap.vocabulary.commands import NAMED, Subject
from valvemap.vocabulary.statuses import Status


@dataclass(frozen=True)
class Command:
    """An operator's command on a valve, or (None) the service.

    ``part`` names the estimator or alarm; ``values`` are the command's numbers; an alarm's command
    has a ``remark``.

    Examples
    --------
    >>> Command.of("set_forgetting_factor", "V1", "RLS", 0.99)
    Command(action='set_forgetting_factor', valve='V1', part='RLS', values=(0.99,), remark=None)
    """

    action: str
    valve: str | None
    part: str = ""
    values: tuple[float, ...] = ()
    remark: Remark | None = None

    @classmethod
    def of(cls, action: str, valve: str | None, *given: Any) -> "Command":  # noqa: ANN401
        """Return a command of `ACTIONS` with its arguments in order."""
        match NAMED[action].on:
            case Subject.ESTIMATOR:
                return cls(action, valve, given[0], tuple(given[1:]))
            case Subject.ALARM:
                return cls(action, valve, given[0], remark=given[1])
            case _:
                return cls(action, valve, values=tuple(given))

    @property
    def arguments(self) -> tuple[Any, ...]:
        """All of it but the action, as given to `of`."""
        match NAMED[self.action].on:
            case Subject.ESTIMATOR:
                return (self.valve, self.part, *self.values)
            case Subject.ALARM:
                return (self.valve, self.part, self.remark)
            case _:
                return (self.valve, *self.values)


T = TypeVar("T")


Answer: TypeAlias = T | Awaitable[T]


class Operator(Protocol):
    """Commands and queries of a results server's clients; they return at once or are awaitable.

    ``valve`` and ``estimator`` are names that the server was built with. A command that is refused
    raises :class:`~valvemap.errors.CommandRejected` with a sentence.
    """

    def do(self, command: Command) -> Answer[None]:
        """Carry out one of :mod:`~valvemap.vocabulary.commands`."""

    def predict(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> Answer[tuple[float, float, Status]]:
        """Q (l/min), its standard deviation and the estimator's status."""

    def predict_measurement(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> Answer[tuple[float, float, float, Status]]:
        """Q, the 95 % interval of a new measurement (l/min), and the estimator's status."""

    def invert(self, valve: str, Q: float, dp: float, T: float) -> Answer[Inversion]:
        """U for a demanded flow at a pressure drop; arrays of shape (1,)."""

    def compare(self, valve: str, estimator: str) -> Answer[Compared]:
        """Return the difference of an estimator's map from the baseline."""

    def predict_approved(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> Answer[tuple[float, float, Status]]:
        """Q (l/min), its standard deviation and status, by the approved map."""

    def baseline(self, valve: int) -> Version | None:
        """Return the baseline of a valve, by its number."""

    def alarmed(self) -> Iterable[str]:
        """Return the valves that have ever had an active alarm."""

    def alarms(self, valve: str | None) -> Sequence[AlarmReport]:
        """Return the state of all alarms of a valve or (None) of the service."""
