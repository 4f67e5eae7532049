"""Operations of one request: a failed operation sets only its own status (Part 4)."""

from collections.abc import Awaitable, Callable, Iterable
from typing import TypeVar

from asyncua import ua
from asyncua.common.utils import ServiceError

from guarded_opcua.logs import bounded_logger

_log = bounded_logger(__name__)
_Codes = ua.StatusCodes

T = TypeVar("T")


async def answer_each(
    operations: Iterable[T],
    answer: Callable[[T], Awaitable[bytes]],
    refusal: Callable[[int], bytes],
    breathe: Callable[[], Awaitable[None]],
    most_bytes: int,
) -> list[bytes]:
    """Answer the operations of a request in order; return their encoded results.

    Parameters
    ----------
    operations
        Operations of the request.
    answer
        Executes one operation and encodes its result. A ServiceError refuses the whole request; any
        other exception sets the status of this operation only.
    refusal
        Encodes the result of an operation that failed, from its status code.
    breathe
        Awaited after each operation; yields to other connections if the time slice is used up.
    most_bytes
        Most bytes of all results.

    Raises
    ------
    ServiceError
        of an operation, or BadResponseTooLarge.
    """
    results, size = [], 0
    for operation in operations:
        try:
            result = await answer(operation)
        except ServiceError:
            raise
        except ua.UaStatusCodeError as error:
            result = refusal(error.code)
        except Exception:  # noqa: BLE001 - a bulkhead: the other operations are answered
            _log.exception("an operation failed: %s", type(operation).__name__)
            result = refusal(_Codes.BadInternalError)
        size += len(result)
        if size > most_bytes:
            raise ServiceError(_Codes.BadResponseTooLarge)
        results.append(result)
        await breathe()
    return results
