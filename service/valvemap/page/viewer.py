"""One open page and the updates it has received."""

import asyncio
from dataclasses import dataclass, field
from typing import Any

from starlette.websockets import WebSocket


@dataclass(eq=False)
class Viewer:
    """One open page.

    Attributes
    ----------
    number
        Order of opening.
    watched
        Name of the valve in view.
    estimator
        Name of the estimator whose map is in view.
    from_afar
        Whether one value a second is enough, as for a trend of a day.
    overview
        Whether the overview is in view.
    seen, events_seen, names_seen, alarms_seen
        Revision, event number, name number and revision of the alarms sent last.
    """

    socket: WebSocket
    number: int = 0  # increases with each viewer
    watched: str | None = None
    estimator: str | None = None
    from_afar: bool = False
    overview: bool = False
    seen: int = 0
    events_seen: int = 0
    names_seen: int = 0
    alarms_seen: int = -1
    greeted: tuple[int, str, str, str] | None = None
    rows_seen: dict[int, Any] = field(default_factory=dict)
    changed: asyncio.Event = field(default_factory=asyncio.Event)
    has_asked: bool = False
    gives_way: asyncio.Event = field(default_factory=asyncio.Event)
