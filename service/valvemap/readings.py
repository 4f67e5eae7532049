"""What a client of the service gets: values of variables, nodes below another."""

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
