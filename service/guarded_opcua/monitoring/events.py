"""Events: who emits one, its type and fields, and who may receive it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from asyncua import ua

from guarded_opcua.security.accounts import Role


@dataclass(frozen=True)
class Event:
    """An event.

    Attributes
    ----------
    emitters
        Objects whose subscribers receive the event.
    kind
        EventType.
    fields
        Fields by browse path, joined by ``/``.
    audience
        Lowest role that receives the event.
    condition
        ConditionId of a condition's event (Part 9, 5.5.2).
    """

    emitters: tuple[ua.NodeId, ...]
    kind: ua.NodeId
    fields: Mapping[str, ua.Variant]
    audience: Role = Role.OBSERVER
    condition: ua.NodeId | None = None


def event_of_asyncua(event: Any) -> Event:  # noqa: ANN401 - asyncua's event objects
    """Convert an event of asyncua's generator."""
    fields = {
        name: ua.Variant(getattr(event, name), kind)
        for name, kind in event.data_types.items()
        if getattr(event, name) is not None
    }
    return Event((event.emitting_node,), event.EventType, fields)
