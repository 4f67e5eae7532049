"""Declarations of variables, methods and arguments of the server's namespace."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from asyncua import ua

from guarded_opcua.address_space.units import Unit
from guarded_opcua.errors import CommandRejected
from guarded_opcua.security.accounts import Role

Range = tuple[float, float]
Value = Any  # bool, int, float, str, or a list or array of them
OnWrite = Callable[[Any], Awaitable[None] | None]
Function = Callable[..., Any]


class OutOfRange(CommandRejected):
    """A number is outside of its allowed range; the status is BadOutOfRange."""


class InvalidArgument(CommandRejected):
    """One argument of a call is invalid; the status is BadInvalidArgument, with its index."""

    def __init__(self, index: int, sentence: str) -> None:
        super().__init__(sentence)
        self.index = index


@dataclass(frozen=True)
class Argument:
    """A method's argument: name, type, description and allowed values.

    ``value_range`` is checked on every call (numbers only); a Double must be finite, or NaN where
    ``or_nan``.
    """

    name: str
    description: str = ""
    type: ua.VariantType = ua.VariantType.Double
    array: bool = False
    unit: Unit | None = None
    value_range: Range | None = None
    or_nan: bool = False


@dataclass(frozen=True)
class Variable:
    """A variable of the server's namespace; the handle for :meth:`HardenedServer.write`."""

    id: ua.NodeId
    type: ua.VariantType
    array: bool = False
    value_range: Range | None = None
    writable_by: Role | None = None
    on_write: OnWrite | None = None
    or_nan: bool = False


@dataclass(frozen=True)
class Method:
    """A method of the server's namespace."""

    id: ua.NodeId
    function: Function
    inputs: tuple[Argument, ...]
    outputs: tuple[Argument, ...]
    required: Role


def argument_of_method(argument: Argument) -> ua.Argument:
    """Return the entry of InputArguments or OutputArguments; unit and range are in its text."""
    text = argument.description
    if argument.unit is not None:
        text = f"{text} [{argument.unit.value[1]}]".strip()
    if argument.value_range is not None:
        low, high = argument.value_range
        text = f"{text} ({low:g} to {high:g})".strip()
    return ua.Argument(
        Name=argument.name,
        DataType=ua.NodeId(argument.type.value),
        ValueRank=ua.ValueRank.OneDimension if argument.array else ua.ValueRank.Scalar,
        ArrayDimensions=[0] if argument.array else [],
        Description=ua.LocalizedText(text),
    )
