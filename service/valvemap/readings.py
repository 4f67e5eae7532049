"""What a client of the service gets: values of variables, nodes below another."""

from collections.abc import Sequence
from typing import Any, Protocol


class Reading(Protocol):
    """One value, its StatusCode, its source time (UTC ns)."""

    @property
    def value(self) -> Any:  # noqa: ANN401 - as the variable's type says
        """None where there is none."""

    @property
    def code(self) -> int:
        """StatusCode."""

    @property
    def t(self) -> int:
        """Source time, UTC ns."""


class Engineering(Protocol):
    """Engineering unit and range of a variable."""

    @property
    def unit(self) -> str:
        """Symbol; empty for numbers without a unit."""

    @property
    def range(self) -> tuple[float, float] | None:
        """Lowest and highest value in normal operation, in the unit."""

    @property
    def description(self) -> str:
        """What the variable is, in one or a few sentences."""


class Child(Protocol):
    """A node below another."""

    @property
    def id(self) -> str:
        """String identifier."""

    @property
    def is_variable(self) -> bool:
        """Whether it is a variable."""

    @property
    def is_method(self) -> bool:
        """Whether it is a method."""


class Course(Protocol):
    """One aggregate of one variable at equal intervals, read from the service's history."""

    @property
    def code(self) -> int:
        """StatusCode of the read: Bad if the variable has no history."""

    @property
    def times(self) -> Sequence[int]:
        """Start of each interval, UTC ns."""

    @property
    def values(self) -> Sequence[float]:
        """Value of each interval; NaN: none."""

    @property
    def codes(self) -> Sequence[int]:
        """StatusCode of each interval."""


class ConditionChange(Protocol):
    """The state of an alarm after a change, by the words of Part 9."""

    @property
    def t(self) -> int:
        """Time of the change, UTC ns."""

    @property
    def turned(self) -> int:
        """Time at which it became active, or inactive, UTC ns; 0: unknown."""

    @property
    def source(self) -> str:
        """Name of the valve, or ``Service``."""

    @property
    def name(self) -> str:
        """Name of the alarm."""

    @property
    def text(self) -> str:
        """Measured values, since when, and possible causes."""

    @property
    def severity(self) -> int:
        """1 … 1,000."""

    @property
    def active(self) -> bool:
        """Whether it is active."""

    @property
    def acked(self) -> bool:
        """Whether it was acknowledged since it was last raised."""

    @property
    def confirmed(self) -> bool:
        """False from Acknowledge until Confirm."""

    @property
    def retain(self) -> bool:
        """Whether it still waits for an operator."""

    @property
    def comment(self) -> str:
        """Newest comment; empty if there is none."""

    @property
    def user(self) -> str:
        """Author of the comment, or of the last action."""

    @property
    def event(self) -> bytes:
        """EventId of the change."""
