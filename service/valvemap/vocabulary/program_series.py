"""All series of `/metrics`, by the command that exposes them."""

from collections.abc import Mapping, Sequence
from typing import Final

from valvemap.vocabulary.fleet_series import OF_COLLECTOR, OF_WORKER
from valvemap.vocabulary.series import OF_MQTT, OF_PAGE, Series

PROGRAMS: Final[Mapping[str, Sequence[Series]]] = {
    "dashboard": OF_PAGE,
    "fleet work": OF_WORKER,
    "fleet collect": OF_COLLECTOR,
    "mqtt": OF_MQTT,
}
"""The series of each command."""
