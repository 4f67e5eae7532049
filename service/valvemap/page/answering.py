"""Requests of one viewer; its questions, some at a time: a slow answer holds up nothing else."""

import asyncio
import json
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

from valvemap.page.questions import Senseless

_AT_ONCE = 4  # the next question is read from the socket when one of them is answered


class Answering:
    """Answers of one viewer.

    Parameters
    ----------
    answer
        Answers a question, by its number.
    """

    def __init__(self, answer: Callable[[int, dict[str, Any]], Awaitable[None]]) -> None:
        self._answer = answer
        self._tasks: set[asyncio.Task[None]] = set()
        self._failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    async def take(self, number: int, question: dict[str, Any]) -> None:
        """Begin to answer a question, as soon as few enough are being answered."""
        while len(self._tasks) >= _AT_ONCE:
            await asyncio.wait(self._tasks, return_when=asyncio.FIRST_COMPLETED)
        task = asyncio.create_task(self._try(number, question))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def until_one_fails(self, listening: Coroutine[Any, Any, None]) -> None:
        """Run ``listening``, which takes questions; end all answers with it.

        Raises
        ------
        Exception
            of ``listening`` or of an answer.
        """
        listener = asyncio.create_task(listening)
        try:
            done, _ = await asyncio.wait(
                {listener, self._failed}, return_when=asyncio.FIRST_COMPLETED
            )
            for one in done:
                one.result()
        finally:
            tasks = {listener, *self._tasks}
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _try(self, number: int, question: dict[str, Any]) -> None:
        try:
            await self._answer(number, question)
        except Exception as error:  # noqa: BLE001 - it is raised where all ends
            if not self._failed.done():
                self._failed.set_exception(error)
                self._failed.exception()  # it may come when all ends anyway


def request_of(text: str | None) -> dict[str, Any]:
    """Return a request, a JSON object.

    Raises
    ------
    Senseless

    >>> request_of('{"ask": 1}')
    {'ask': 1}
    """
    try:
        request = json.loads(text or "", parse_constant=_refuse)
    except (ValueError, RecursionError):
        raise Senseless from None
    if not isinstance(request, dict):
        raise Senseless
    return request


def _refuse(_constant: str) -> None:
    raise ValueError
