"""Statistics of librdkafka, the library below Kafka's clients: lag and queues. Pure.

Its document STATISTICS.md defines the fields. The statistics come from our own process, but of
another library's version: a field that is missing or not a number is left out.
"""

import json
import math
from dataclasses import dataclass, field
from typing import Any, Final

EVERY_MS: Final = 5_000  # ms; interval of the statistics
_MOST: Final = 2**63  # largest offset


@dataclass(frozen=True)
class ClientStatistics:
    """Queues of one client.

    Attributes
    ----------
    lag
        By topic and partition assigned to it, messages that it has not received yet.
    fetched
        By topic and partition, messages received and not yet returned to the caller.
    unsent
        Messages that wait for the broker.
    """

    lag: dict[tuple[str, str], float] = field(default_factory=dict)
    fetched: dict[tuple[str, str], float] = field(default_factory=dict)
    unsent: float = 0.0


def read_statistics(packed: str) -> ClientStatistics:
    """Decode statistics; empty ones if they cannot be decoded.

    >>> one = '{"desired": true, "ls_offset": 9, "app_offset": 2, "fetchq_cnt": 2}'
    >>> read_statistics(f'{{"topics": {{"t": {{"partitions": {{"0": {one}}}}}}}}}').lag
    {('t', '0'): 7.0}
    """
    try:
        said = json.loads(packed)
    except (ValueError, RecursionError):
        return ClientStatistics()
    lag, fetched = dict[tuple[str, str], float](), dict[tuple[str, str], float]()
    for topic, of_topic in _table(_table(said).get("topics")).items():
        for partition, one in _table(_table(of_topic).get("partitions")).items():
            known = _table(one)
            if known.get("desired") is not True or not partition.isdigit():
                continue  # -1 is the library's own queue
            lag[topic, partition] = _lag(known)
            fetched[topic, partition] = _number(known.get("fetchq_cnt"))
    return ClientStatistics(lag, fetched, _number(_table(said).get("msg_cnt")))


def _lag(known: dict[str, Any]) -> float:
    """Messages up to the last stable offset that the library has not returned to its caller.

    The library's own ``consumer_lag`` needs commits by the consumer; with transactions, the
    producer commits.
    """
    end, at = _number(known.get("ls_offset")), _number(known.get("app_offset"))
    if math.isnan(at):  # no message returned since the partition was assigned
        at = _number(known.get("next_offset"))
    return max(end - at, 0.0)


def _table(found: Any) -> dict[str, Any]:  # noqa: ANN401 - any JSON
    return found if isinstance(found, dict) else {}


def _number(found: Any) -> float:  # noqa: ANN401 - any JSON
    """Return a number; NaN for one that is unknown, which the library gives as a negative one."""
    is_number = isinstance(found, int | float) and not isinstance(found, bool)
    return float(found) if is_number and 0 <= found < _MOST else math.nan
