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
