"""State of the primary host, which an edge node waits for. Pure."""

import json
from typing import Final

from valvemap.sparkplug.edge_node import NAMESPACE

_LATEST_MS: Final = 2**63  # ms; later timestamps are invalid


class PrimaryHost:
    """State of a primary host, from its STATE messages (chapter 5.10).

    Attributes
    ----------
    topic : str
        Topic of its STATE messages.
    is_online : bool
        Whether its newest STATE message says online.

    Examples
    --------
    >>> host = PrimaryHost("SCADA")
    >>> host.hear(b'{"online": true, "timestamp": 5}')
    >>> host.hear(b'{"online": false, "timestamp": 4}')  # the will of an earlier connection
    >>> host.topic, host.is_online
    ('spBv1.0/STATE/SCADA', True)
    """

    def __init__(self, name: str) -> None:
        self.topic = f"{NAMESPACE}/STATE/{name}"
        self.is_online = False
        self._when = 0

    def hear(self, payload: bytes) -> None:
        """Process a STATE message; ignore it if it is invalid or older than the last one."""
        try:
            said = json.loads(payload)
            online, when = said["online"], said["timestamp"]
        except (ValueError, KeyError, TypeError, RecursionError):
            return
        if not isinstance(online, bool) or isinstance(when, bool) or not isinstance(when, int):
            return
        if self._when <= when < _LATEST_MS:
            self.is_online, self._when = online, when
