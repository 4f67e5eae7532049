"""Notification of the callbacks on an attribute."""

from collections.abc import Coroutine
from typing import Any

from asyncua import ua
from asyncua.server.address_space import AttributeValue


def notify(held: AttributeValue, data: ua.DataValue) -> None:
    """Call the callbacks of an attribute with its new value."""
    for handle, callback in list(held.datachange_callbacks.items()):
        outcome = callback(handle, data)
        if isinstance(outcome, Coroutine):  # a callback of the internal session
            drive(outcome)


def drive(coroutine: Coroutine[Any, Any, Any]) -> None:
    """Run a coroutine that never suspends, such as a callback that only queues.

    Raises
    ------
    RuntimeError
        if it suspends.
    """
    try:
        coroutine.send(None)
    except StopIteration:
        return
    coroutine.close()
    raise RuntimeError("a coroutine that must not wait waits")
