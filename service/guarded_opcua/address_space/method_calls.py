"""Method calls in the server's namespace (Part 4, 5.12)."""

import inspect
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from asyncua import ua

from guarded_opcua.address_space.declarations import InvalidArgument, Method, OutOfRange, Value
from guarded_opcua.address_space.plain_values import as_variant, check, plain
from guarded_opcua.errors import CommandRejected
from guarded_opcua.logs import bounded_logger

_log = bounded_logger(__name__)

Outside = Callable[[Awaitable[Any]], Awaitable[Any]]


async def call_method(
    method: Method, arguments: Sequence[ua.Variant], outside: Outside
) -> ua.CallMethodResult:
    """Check the arguments, run the method, and return its result or status.

    An awaitable result is awaited by ``outside``, so that other connections are served.
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
    except Exception:  # noqa: BLE001 - each call is answered, even if the method fails
        _log.exception("%s(%s) failed", method.id.Identifier, _shown(values))
        result.StatusCode = ua.StatusCode(ua.StatusCodes.BadInternalError)
    return result


def rejection_code(error: CommandRejected) -> int:
    """Return the status code of a rejected command."""
    if isinstance(error, OutOfRange):
        return ua.StatusCodes.BadOutOfRange
    return ua.StatusCodes.BadInvalidState


def _outputs(method: Method, outcome: Value) -> list[ua.Variant]:
    if not method.outputs:
        return []
    values = outcome if isinstance(outcome, tuple) else (outcome,)
    return [
        as_variant(argument.type, value, array=argument.array)
        for argument, value in zip(method.outputs, values, strict=True)
    ]


def _shown(values: Sequence[Any]) -> str:
    return ", ".join(repr(value)[:60] for value in values)
