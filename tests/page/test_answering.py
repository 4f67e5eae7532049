"""Questions of one viewer are answered some at a time."""

import asyncio

import pytest

from valvemap.page.answering import Answering, request_of
from valvemap.page.questions import Senseless

AT_ONCE = 4


class Asked:
    """Answers when it is told to, and counts."""

    def __init__(self):
        self.begun, self.ended, self.may_end = [], [], asyncio.Event()

    async def __call__(self, number, question):
        if question.get("senseless"):
            raise Senseless
        self.begun.append(number)
        if question.get("slow"):
            await self.may_end.wait()
        self.ended.append(number)


async def never():
    await asyncio.Event().wait()


async def test_a_slow_answer_holds_up_no_other():
    asked = Asked()
    answering = Answering(asked)

    async def listen():
        await answering.take(1, {"slow": True})
        await answering.take(2, {})
        await asyncio.sleep(0)
        assert asked.ended == [2]
        asked.may_end.set()
        await asyncio.sleep(0.01)

    await answering.until_one_fails(listen())
    assert asked.ended == [2, 1]


async def test_the_next_question_waits_while_as_many_are_answered_as_may_be():
    asked = Asked()
    answering = Answering(asked)

    async def listen():
        for number in range(AT_ONCE + 1):
            await answering.take(number, {"slow": True})
        await asyncio.sleep(0.01)

    listening = asyncio.create_task(answering.until_one_fails(listen()))
    await asyncio.sleep(0.01)
    assert asked.begun == list(range(AT_ONCE))
    asked.may_end.set()
    await listening
    assert len(asked.ended) == AT_ONCE + 1


async def test_who_leaves_ends_all_answers():
    asked = Asked()
    answering = Answering(asked)

    async def leave():
        await answering.take(1, {"slow": True})
        await asyncio.sleep(0)

    await answering.until_one_fails(leave())
    asked.may_end.set()
    await asyncio.sleep(0)
    assert asked.begun == [1]
    assert asked.ended == []


async def test_a_senseless_question_ends_the_viewer():
    answering = Answering(Asked())

    async def listen():
        await answering.take(1, {"senseless": True})
        await never()

    with pytest.raises(Senseless):
        await answering.until_one_fails(listen())


@pytest.mark.parametrize("text", [None, "", "[1]", "NaN", '{"a": NaN}', "{" * 5_000, "1"])
def test_what_is_no_object_is_senseless(text):
    with pytest.raises(Senseless):
        request_of(text)
