"""Who watches an attribute is notified of its new value."""

from collections.abc import Coroutine
from typing import Any

from asyncua import ua
from asyncua.server.address_space import AttributeValue


def notify(held: AttributeValue, data: ua.DataValue) -> None:
    """Notify whoever watches an attribute of its new value."""
    for handle, callback in list(held.datachange_callbacks.items()):
        outcome = callback(handle, data)
        if isinstance(outcome, Coroutine):  # of the server's own session
            drive(outcome)


def drive(coroutine: Coroutine[Any, Any, Any]) -> None:
    """Run a coroutine that never waits: the callbacks behind a write only queue.

    Raises
    ------
    RuntimeError
        if it waits.
    """
    try:
        coroutine.send(None)
    except StopIteration:
        return
    coroutine.close()
    raise RuntimeError("a coroutine that must not wait waits")
