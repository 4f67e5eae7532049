"""How a device's metrics are arranged in its messages: one by one, or in an instance of a template.

Pure. The edge node's own metrics are always published one by one.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple, Protocol

from valvemap.sparkplug.metrics import Tag, Value, add_birth, add_data


class Change(NamedTuple):
    """A metric's new value; ``number`` counts the changes of the process."""

    tag: Tag
    value: Value
    number: int = 0


Bearing = Sequence[tuple[Tag, Value]]
"""The metrics of a birth with their current values."""


class Structure(Protocol):
    """Arranges the metrics of devices; its methods add to a Payload."""

    @property
    def prefix(self) -> str:
        """Precedes a metric's name in commands that name it by its path."""

    def define(self, payload: Any, tags: Mapping[str | None, Sequence[Tag]], now: int) -> None:  # noqa: ANN401
        """Add to NBIRTH what the births of these devices refer to."""

    def bear(self, payload: Any, device: str, metrics: Bearing, now: int) -> None:  # noqa: ANN401
        """Add the metrics of a device to its DBIRTH."""

    def change(self, payload: Any, device: str, changes: Iterable[Change], born: int) -> None:  # noqa: ANN401
        """Add changes to a DDATA; those numbered up to ``born`` are historical."""


class Flat:
    """One metric per variable, such as ``Auto/Residual``."""

    prefix: Final = ""

    def define(self, payload: Any, tags: Mapping[str | None, Sequence[Tag]], now: int) -> None:  # noqa: ANN401
        """Add nothing: each metric describes itself."""

    def bear(self, payload: Any, device: str, metrics: Bearing, now: int) -> None:  # noqa: ANN401, ARG002
        """Add the metrics of a device to its DBIRTH."""
        add_births(payload, metrics)

    def change(self, payload: Any, device: str, changes: Iterable[Change], born: int) -> None:  # noqa: ANN401, ARG002
        """Add changes to a DDATA; those numbered up to ``born`` are historical."""
        add_changes(payload, changes, born)


def add_births(container: Any, metrics: Bearing) -> None:  # noqa: ANN401
    """Add metrics with their descriptions to a Payload."""
    for tag, value in metrics:
        add_birth(container, tag, value)


def add_changes(container: Any, changes: Iterable[Change], born: int) -> None:  # noqa: ANN401
    """Add changes to a Payload or to an instance; those numbered up to ``born`` are historical."""
    for change in changes:
        add_data(container, change.tag, change.value, historical=change.number <= born)
