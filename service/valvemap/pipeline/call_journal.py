"""Journal of the calls that change a state, so that a successor can repeat them. Pure."""

from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, Final, ParamSpec, Protocol, TypeVar

from valvemap.pipeline.data_changes import DataChanges

MOST: Final = 2_000_000  # data changes and calls; 50 MB, 55 min of six signals at 100 Hz

Call = tuple[str, tuple[Any, ...], dict[str, Any]]

P = ParamSpec("P")
R = TypeVar("R")


class CallJournal:
    """Names and arguments of calls, in order, until they are taken.

    It holds references, no copies. Its owner makes no further calls when it is full.
    """

    def __init__(self) -> None:
        self._calls: list[Call] = []
        self._size = 0

    def note(self, name: str, args: tuple[Any, ...], kws: dict[str, Any]) -> None:
        """Append a call."""
        self._calls.append((name, args, kws))
        self._size += 1 + sum(len(one) for one in args if isinstance(one, DataChanges))

    def take_new(self) -> list[Call]:
        """Return and remove all calls."""
        taken, self._calls, self._size = self._calls, [], 0
        return taken

    @property
    def is_full(self) -> bool:
        """Whether it holds MOST data changes and calls."""
        return self._size >= MOST


class Journaled(Protocol):
    """Owner of a journal, None: its calls are not noted; ``changes``: number of counted calls."""

    journal: CallJournal | None
    changes: int


J = TypeVar("J", bound=Journaled)


def noted_call(method: Callable[Concatenate[J, P], R]) -> Callable[Concatenate[J, P], R]:
    """Note each call of a method in its object's journal, if there is one."""

    @wraps(method)
    def noted(self: J, /, *args: P.args, **kws: P.kwargs) -> R:
        if self.journal is not None:
            self.journal.note(method.__name__, args, kws)
        return method(self, *args, **kws)

    return noted


def changes_state(method: Callable[Concatenate[J, P], R]) -> Callable[Concatenate[J, P], R]:
    """As `noted_call`, and count the call: kept states may differ from now on."""
    noted = noted_call(method)

    @wraps(method)
    def counted(self: J, /, *args: P.args, **kws: P.kwargs) -> R:
        self.changes += 1
        return noted(self, *args, **kws)

    return counted
