"""The alarms of the service itself, one row an alarm.

Nodes (`s=Service.Alarms.<label>`), their conditions, the configuration's names and the
documentation are made from these rows. A new alarm is a row here, its rule in
``pipeline/service_alarms.py``, its text in ``pipeline/alarm_words.py``, what to do in
``vocabulary/alarm_guide.py`` and its health in ``pipeline/device_health.py``; the service that has
it passes its quantity to `ServiceAlarms.note`.
"""

from collections.abc import Sequence
from typing import Final

from valvemap.vocabulary.statuses import Described


class ServiceAlarm(Described):
    """Alarms of the service; the label is the name in NodeIds and configuration."""

    CHECKPOINT = 0, "Checkpoint", "States are not saved."
    CERTIFICATE = 1, "Certificate", "The service's certificate expires soon."
    LOAD = 2, "Load", "The service is close to its limit of processing time."
    MESSAGES_REJECTED = 3, "MessagesRejected", "Messages or states of the fleet are rejected."
    HISTORY = 4, "History", "Rows of the history cannot be saved, or are lost."


OF_SERVE: Final[Sequence[ServiceAlarm]] = (
    ServiceAlarm.CHECKPOINT,
    ServiceAlarm.CERTIFICATE,
    ServiceAlarm.LOAD,
    ServiceAlarm.HISTORY,
)
"""Of every results server."""

OF_FLEET: Final[Sequence[ServiceAlarm]] = (*OF_SERVE, ServiceAlarm.MESSAGES_REJECTED)
"""Of `fleet serve`."""
