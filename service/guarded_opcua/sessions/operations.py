"""Operations of one request: a failed operation sets only its own status (Part 4)."""

from collections.abc import Awaitable, Callable, Iterable, Sequence
from typing import Any, TypeVar

from asyncua import ua
from asyncua.common.utils import ServiceError

from guarded_opcua.binary.encoding import encode_results, encode_structure, ticks_of_ns
from guarded_opcua.clock import Clock
from guarded_opcua.logs import bounded_logger
from guarded_opcua.sessions.requests import Request
from guarded_opcua.settings import Limits

_log = bounded_logger(__name__)
_Codes = ua.StatusCodes

T = TypeVar("T")


class Operations:
    """Checks the number of a request's operations, answers them, encodes their results."""

    def __init__(self, limits: Limits, clock: Clock) -> None:
        self._limits = limits
        self._clock = clock

    async def answer(
        self,
        request: Request,
        kind: int,
        operations: Sequence[T],
        answer: Callable[[T], Awaitable[bytes]],
        refusal: Callable[[int], bytes],
        *,
        most: int | None = None,
    ) -> bytes:
        """Return the encoded response of a kind: their number checked, a result for each.

        Raises
        ------
        ServiceError
            see `check_count` and :func:`answer_each`.
        """
        self.check_count(operations, most)
        return self.results(request, kind, await self.each(request, operations, answer, refusal))

    def check_count(self, operations: Sequence[Any] | None, most: int | None = None) -> None:
        """Check that there are operations, and at most ``most``; None: the server's limit.

        Raises
        ------
        ServiceError
            BadNothingToDo, BadTooManyOperations.
        """
        if not operations:
            raise ServiceError(_Codes.BadNothingToDo)
        if len(operations) > (self._limits.operations if most is None else most):
            raise ServiceError(_Codes.BadTooManyOperations)

    async def each(
        self,
        request: Request,
        operations: Sequence[T],
        answer: Callable[[T], Awaitable[bytes]],
        refusal: Callable[[int], bytes],
    ) -> list[bytes]:
        """Answer the operations in turns of the request; see :func:`answer_each`."""
        most = self._limits.response_bytes
        return await answer_each(operations, answer, refusal, request.turn.breathe, most)

    def results(self, request: Request, kind: int, *results: Sequence[bytes]) -> bytes:
        """Return the encoded response of a kind, with one or more arrays of encoded results."""
        return encode_results(kind, request.handle, self.ticks(), *results)

    def ticks(self) -> int:
        """Return the time of a response: 100 ns since 1601."""
        return ticks_of_ns(self._clock.now())


def refusal(result: type) -> Callable[[int], bytes]:
    """Return an encoder of results of this type that hold only a status code."""
    return lambda code: encode_structure(result(StatusCode=ua.StatusCode(code)))


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
