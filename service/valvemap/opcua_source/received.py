"""Messages received of a subscription: their parts, counters, and state between connections."""

from dataclasses import dataclass

from asyncua import ua

from valvemap.opcua_source.monitored_items import Item
from valvemap.pipeline.data_changes import DataChanges


@dataclass
class Tally:
    """Counters over all connections."""

    notifications: int = 0
    publish_responses: int = 0
    missing_messages: int = 0
    overflows: int = 0
    undecodable: int = 0
    from_history: int = 0


@dataclass(frozen=True)
class Part:
    """The changes of one message, its sequence number, and the losses before it.

    ``behind_gap``: messages before it are missing. ``overflows``: changes with the Overflow bit.
    """

    changes: DataChanges
    subscription: int
    message: int
    behind_gap: bool
    overflows: int


@dataclass(frozen=True)
class Left:
    """The state of a subscription that still exists at the server, without a connection.

    Attributes
    ----------
    created
        The server's response to CreateSubscription.
    next_message
        Sequence number of the next message; None before the first.
    acknowledgements
        Acknowledgements that were not sent.
    buffer
        Received changes that were not fetched.
    items
        The monitored items.
    kept_back
        Sequence numbers to acknowledge only after a commit; None: acknowledge at once.
    behind_gap
        Whether messages before the next one are missing.
    """

    created: ua.CreateSubscriptionResult
    next_message: int | None
    acknowledgements: tuple[ua.SubscriptionAcknowledgement, ...]
    buffer: tuple[Part, ...]
    items: tuple[Item, ...]
    kept_back: tuple[int, ...] | None = None
    behind_gap: bool = False
