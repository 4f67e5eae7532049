"""Runtime checks of protocols that ask each class once: `typing` asks every object, in 12 µs."""

from abc import ABCMeta
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    _MetaOfProtocols = ABCMeta
else:
    _MetaOfProtocols = type(Protocol)

_KNOWN: dict[tuple[type, type], bool] = {}  # by protocol and class


class CheckedByClass(_MetaOfProtocols):
    """Metaclass of a protocol that all objects of a class implement, or none.

    Examples
    --------
    >>> from typing import Protocol, runtime_checkable
    >>> @runtime_checkable
    ... class Sized(Protocol, metaclass=CheckedByClass):
    ...     def __len__(self) -> int: ...
    >>> isinstance([], Sized), isinstance([1], Sized), isinstance(1, Sized)
    (True, True, False)
    """

    def __instancecheck__(cls, instance: Any) -> bool:  # noqa: ANN401, N805 - a metaclass
        """Whether the class of an object has the members of the protocol."""
        key = cls, type(instance)
        if key not in _KNOWN:
            _KNOWN[key] = super().__instancecheck__(instance)
        return _KNOWN[key]
