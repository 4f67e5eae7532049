"""Objects, variables and methods of a hardened server's own namespace."""

import inspect
import math
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from asyncua import ua

from service.errors import CommandRejected, ServerError
from service.opcua.hardened.insertion import insert, property_item
from service.opcua.hardened.logs import bounded_logger
from service.opcua.hardened.units import Unit
from service.opcua.hardened.users import Role

if TYPE_CHECKING:
    from service.opcua.hardened.server import HardenedServer

_log = bounded_logger(__name__)

Range = tuple[float, float]
Value = Any  # what a variable holds: bool, int, float, str, or a list or array of them
OnWrite = Callable[[Any], None] | Callable[[Any], Awaitable[None]]
Function = Callable[..., Any]
Outside = Callable[[Awaitable[Any]], Awaitable[Any]]

_ANALOG_UNIT_RANGE_TYPE = ua.NodeId(17570)
_FLOATS = {ua.VariantType.Double, ua.VariantType.Float}
_INTEGERS = {
    ua.VariantType.SByte: (-(2**7), 2**7 - 1),
    ua.VariantType.Byte: (0, 2**8 - 1),
    ua.VariantType.Int16: (-(2**15), 2**15 - 1),
    ua.VariantType.UInt16: (0, 2**16 - 1),
    ua.VariantType.Int32: (-(2**31), 2**31 - 1),
    ua.VariantType.UInt32: (0, 2**32 - 1),
    ua.VariantType.Int64: (-(2**63), 2**63 - 1),
    ua.VariantType.UInt64: (0, 2**64 - 1),
}


class OutOfRange(CommandRejected):
    """A number lies outside of what is allowed; OPC UA says BadOutOfRange."""


class InvalidArgument(CommandRejected):
    """One argument of a call makes no sense; OPC UA says BadInvalidArgument and which one."""

    def __init__(self, index: int, sentence: str) -> None:
        super().__init__(sentence)
        self.index = index


@dataclass(frozen=True)
class Argument:
    """A method's argument: name, type, what it means and what is allowed.

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
    """A variable of our own: what :meth:`HardenedServer.write` and its peers need to know."""

    id: ua.NodeId
    type: ua.VariantType
    array: bool = False
    value_range: Range | None = None
    writable_by: Role | None = None
    on_write: OnWrite | None = None
    or_nan: bool = False


@dataclass(frozen=True)
class Method:
    """A method of our own."""

    id: ua.NodeId
    function: Function
    inputs: tuple[Argument, ...]
    outputs: tuple[Argument, ...]
    required: Role


async def add_object(
    server: "HardenedServer",
    parent: ua.NodeId | None,
    id: str,  # noqa: A002 - OPC UA's word
    *,
    description: str = "",
    type_definition: ua.NodeId | None = None,
) -> ua.NodeId:
    """Add an object.

    Parameters
    ----------
    server
        Where.
    parent
        The object that organizes it; None is the Objects folder.
    id
        String identifier; its last segment (after ``.``) becomes the BrowseName.
    description
        A sentence for who browses.
    type_definition
        Its type; BaseObjectType if None.

    Returns
    -------
    NodeId
    """
    item = _item(server, parent, id, ua.NodeClass.Object)
    organizes = parent is None or parent.NamespaceIndex == 0
    item.ReferenceTypeId = ua.NodeId(
        ua.ObjectIds.Organizes if organizes else ua.ObjectIds.HasComponent
    )
    item.TypeDefinition = type_definition or ua.NodeId(ua.ObjectIds.BaseObjectType)
    item.NodeAttributes = ua.ObjectAttributes(
        DisplayName=ua.LocalizedText(item.BrowseName.Name),
        Description=ua.LocalizedText(description),
        EventNotifier=0,
    )
    return await _add(server, item)


async def add_variable(
    server: "HardenedServer",
    parent: ua.NodeId,
    id: str,  # noqa: A002 - OPC UA's word
    value: Value,
    *,
    description: str = "",
    type: ua.VariantType = ua.VariantType.Double,  # noqa: A002
    unit: Unit | None = None,
    value_range: Range | None = None,
    dimensions: Sequence[int] | None = None,
    enum_strings: Sequence[str] | None = None,
    writable_by: Role | None = None,
    on_write: OnWrite | None = None,
    or_nan: bool = False,
) -> Variable:
    """Add a variable.

    Parameters
    ----------
    server, parent
        Where; the variable is a component of the parent.
    id
        String identifier, e.g. ``Valvistor.U``; its last segment becomes the BrowseName.
    value
        First value; None starts as BadWaitingForInitialData.
    description
        A sentence for who browses.
    type
        Data type.
    unit
        Makes it an AnalogUnitRangeType with EngineeringUnits, EURange and InstrumentRange.
    value_range
        Lowest and highest value; peers cannot write beyond it. Needed with a unit.
    dimensions
        None: a scalar. Otherwise the length of each dimension, 0 = any.
    enum_strings
        Names of the values 0, 1, …, as property EnumStrings.
    writable_by
        The least role that may write; None: nobody.
    on_write
        Called with each value a peer writes, after type and range were checked and before the
        value is taken; raise :class:`~service.errors.CommandRejected` to refuse it.
    or_nan
        Peers may write NaN, too.

    Returns
    -------
    Variable
        Handle for :meth:`HardenedServer.write`.
    """
    item = _item(server, parent, id, ua.NodeClass.Variable)
    item.ReferenceTypeId = ua.NodeId(ua.ObjectIds.HasComponent)
    item.TypeDefinition = _variable_type(unit, value_range)
    access = 1 << ua.AccessLevel.CurrentRead
    if writable_by is not None:
        access |= 1 << ua.AccessLevel.CurrentWrite
    item.NodeAttributes = ua.VariableAttributes(
        DisplayName=ua.LocalizedText(item.BrowseName.Name),
        Description=ua.LocalizedText(description),
        DataType=ua.NodeId(type.value),
        ValueRank=ua.ValueRank.Scalar if dimensions is None else ua.ValueRank(len(dimensions)),
        ArrayDimensions=list(dimensions or ()),
        AccessLevel=access,
        UserAccessLevel=access,
        MinimumSamplingInterval=0.0,
        Historizing=False,
        Value=ua.Variant(None, ua.VariantType.Null),
    )
    variable = Variable(
        id=await _add(server, item),
        type=type,
        array=dimensions is not None,
        value_range=value_range,
        writable_by=writable_by,
        on_write=on_write,
        or_nan=or_nan,
    )
    if unit is not None and value_range is not None:
        low, high = value_range
        span = ua.Range(Low=low, High=high)
        await _add_property(server, variable.id, "EngineeringUnits", unit.information)
        await _add_property(server, variable.id, "EURange", span)
        await _add_property(server, variable.id, "InstrumentRange", span)
    if enum_strings is not None:
        texts = [ua.LocalizedText(text) for text in enum_strings]
        await _add_property(server, variable.id, "EnumStrings", texts)
    server.register_variable(variable, value)
    return variable


async def add_method(
    server: "HardenedServer",
    parent: ua.NodeId,
    id: str,  # noqa: A002 - OPC UA's word
    function: Function,
    *,
    inputs: Sequence[Argument] = (),
    outputs: Sequence[Argument] = (),
    required: Role,
    description: str = "",
) -> ua.NodeId:
    """Add a method.

    Parameters
    ----------
    server, parent
        Where; the method is a component of the parent.
    id
        String identifier; its last segment becomes the BrowseName.
    function
        Called with the arguments' plain values, once their number, types and ranges are checked;
        may be a coroutine function. Returns the outputs: a tuple, one value for a single output,
        or None for none. :class:`~service.errors.CommandRejected` becomes BadInvalidState,
        :class:`OutOfRange` BadOutOfRange.
    inputs, outputs
        Arguments.
    required
        The least role that may call it.
    description
        A sentence for who browses.
    """
    item = _item(server, parent, id, ua.NodeClass.Method)
    item.ReferenceTypeId = ua.NodeId(ua.ObjectIds.HasComponent)
    item.NodeAttributes = ua.MethodAttributes(
        DisplayName=ua.LocalizedText(item.BrowseName.Name),
        Description=ua.LocalizedText(description),
        Executable=True,
        UserExecutable=True,
    )
    method = Method(await _add(server, item), function, tuple(inputs), tuple(outputs), required)
    for name, arguments in (("InputArguments", inputs), ("OutputArguments", outputs)):
        if arguments:
            await _add_property(server, method.id, name, [_described(a) for a in arguments])
    server.register_method(method)
    return method.id


async def call(
    method: Method, arguments: Sequence[ua.Variant], outside: Outside
) -> ua.CallMethodResult:
    """Check the arguments, run the method, turn what it says into a result.

    What the method waits for is awaited by ``outside``, so that others are served meanwhile.
    """
    result = ua.CallMethodResult()
    if len(arguments) != len(method.inputs):
        few = len(arguments) < len(method.inputs)
        codes = ua.StatusCodes
        code = codes.BadArgumentsMissing if few else codes.BadTooManyArguments
        result.StatusCode = ua.StatusCode(code)
        return result
    found = [
        check(argument, given) for argument, given in zip(method.inputs, arguments, strict=True)
    ]
    if any(code != ua.StatusCodes.Good for code in found):
        result.StatusCode = ua.StatusCode(ua.StatusCodes.BadInvalidArgument)
        result.InputArgumentResults = [ua.StatusCode(code) for code in found]
        return result
    values = [plain(given) for given in arguments]
    try:
        outcome = method.function(*values)
        if inspect.isawaitable(outcome):
            outcome = await outside(outcome)
        result.OutputArguments = _outputs(method, outcome)
        result.InputArgumentResults = [ua.StatusCode() for _ in values]
    except InvalidArgument as error:
        _log.warning("%s(%s) refused: %s", method.id.Identifier, _shown(values), error)
        found[error.index] = ua.StatusCodes.BadOutOfRange
        result.StatusCode = ua.StatusCode(ua.StatusCodes.BadInvalidArgument)
        result.InputArgumentResults = [ua.StatusCode(code) for code in found]
    except CommandRejected as error:
        _log.warning("%s(%s) refused: %s", method.id.Identifier, _shown(values), error)
        result.StatusCode = ua.StatusCode(rejection_code(error))
    except Exception:  # noqa: BLE001 - a method must answer, whatever happens in it
        _log.exception("%s(%s) failed", method.id.Identifier, _shown(values))
        result.StatusCode = ua.StatusCode(ua.StatusCodes.BadInternalError)
    return result


def rejection_code(error: CommandRejected) -> int:
    """Status code of a command that was refused."""
    if isinstance(error, OutOfRange):
        return ua.StatusCodes.BadOutOfRange
    return ua.StatusCodes.BadInvalidState


def check(expected: Argument | Variable, given: ua.Variant) -> int:
    """Check type, shape, finiteness and range of a value that a peer sent; a status code."""
    if given.VariantType != expected.type or bool(given.is_array) != expected.array:
        return ua.StatusCodes.BadTypeMismatch
    values = ua.flatten(given.Value) if expected.array else [given.Value]
    if values is None or (expected.type != ua.VariantType.String and None in values):
        return ua.StatusCodes.BadTypeMismatch
    if expected.or_nan:
        values = [value for value in values if not math.isnan(value)]
    if expected.type in _FLOATS and not all(math.isfinite(value) for value in values):
        return ua.StatusCodes.BadOutOfRange
    if expected.value_range is not None:
        low, high = expected.value_range
        if not all(low <= value <= high for value in values):
            return ua.StatusCodes.BadOutOfRange
    return ua.StatusCodes.Good


def plain(given: ua.Variant) -> Value:
    """Return the Python value of a variant."""
    return "" if given.Value is None and given.VariantType == ua.VariantType.String else given.Value


def as_variant(kind: ua.VariantType, value: Value, *, array: bool = False) -> ua.Variant:
    """Make a variant of our own value (numpy arrays and scalars too)."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if array:
        return ua.Variant(list(value), kind, is_array=True)
    if kind in _INTEGERS:
        value = int(value)
    return ua.Variant(value, kind)


def _outputs(method: Method, outcome: Value) -> list[ua.Variant]:
    if not method.outputs:
        return []
    values = outcome if isinstance(outcome, tuple) else (outcome,)
    return [
        as_variant(argument.type, value, array=argument.array)
        for argument, value in zip(method.outputs, values, strict=True)
    ]


def _item(
    server: "HardenedServer", parent: ua.NodeId | None, name: str, node_class: ua.NodeClass
) -> ua.AddNodesItem:
    item = ua.AddNodesItem()
    item.ParentNodeId = parent or ua.NodeId(ua.ObjectIds.ObjectsFolder)
    item.RequestedNewNodeId = ua.NodeId(name, server.namespace_index)
    item.BrowseName = ua.QualifiedName(name.rsplit(".", 1)[-1], server.namespace_index)
    item.NodeClass = node_class
    return item


async def _add(server: "HardenedServer", item: ua.AddNodesItem) -> ua.NodeId:
    return insert(server.address_space, item)


async def _add_property(
    server: "HardenedServer", parent: ua.NodeId, name: str, value: Value
) -> None:
    nodeid = ua.NodeId(f"{parent.Identifier}.{name}", server.namespace_index)
    insert(server.address_space, property_item(parent, nodeid, name, value))


def _variable_type(unit: Unit | None, value_range: Range | None) -> ua.NodeId:
    if unit is None:
        return ua.NodeId(ua.ObjectIds.BaseDataVariableType)
    if value_range is None:
        raise ServerError("a variable with a unit needs a value_range")
    return _ANALOG_UNIT_RANGE_TYPE


def _described(argument: Argument) -> ua.Argument:
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


def _shown(values: Sequence[Any]) -> str:
    return ", ".join(repr(value)[:60] for value in values)
