"""The metrics of the MQTT publisher, read from its parts on request."""

from collections.abc import Iterator

from valvemap.sparkplug.outbox import Outbox
from valvemap.sparkplug.sender import Sender
from valvemap.sparkplug.shown import CONNECTIONS, LOST, OVERFLOWS, REFUSED, Shown
from valvemap.vocabulary import series
from valvemap.vocabulary.series import Point


def mqtt_points(shown: Shown, outbox: Outbox, sender: Sender, most_waiting: int) -> Iterator[Point]:
    """Yield all metrics; may be called in another thread."""
    yield Point(series.SERVICE_UP, float(shown.is_connected))
    yield Point(series.BROKER_UP, float(sender.is_sending))
    yield Point(series.MQTT_WAITING, len(outbox))
    yield Point(series.MQTT_LIMIT, most_waiting)
    newest = shown.newest
    for own, one in _OWN.items():
        yield Point(one, float(newest[own].value or 0))
    yield Point(series.MQTT_METRICS, sum(len(tags) for tags in list(shown.tags.values())))


_OWN = {
    LOST: series.MQTT_LOST,
    OVERFLOWS: series.MQTT_OVERFLOWS,
    REFUSED: series.MQTT_REFUSED,
    CONNECTIONS: series.MQTT_CONNECTIONS,
}
