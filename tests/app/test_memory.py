"""Memory that was needed for a moment goes back to the system."""

import asyncio
import os
import sys
from pathlib import Path

import pytest

from valvemap.app import memory
from valvemap.app.memory import giving_back, trimming

MB = 1e6


def resident() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / MB


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads Linux's /proc")
@pytest.mark.skipif(trimming() is None, reason="the C library keeps what it has")
def test_what_lies_between_pieces_in_use_is_given_back():
    trim = trimming()
    pieces = [bytes(50_000) for _ in range(2_000)]  # 100 MB, in pieces
    kept = pieces[::20]
    del pieces
    before = resident()
    trim()
    assert resident() < before - 40.0
    assert all(piece == bytes(50_000) for piece in kept)


async def test_it_is_asked_for_again_and_again(monkeypatch):
    calls, often = [], asyncio.Event()
    loop = asyncio.get_running_loop()

    def trim():
        calls.append(None)
        if len(calls) == 3:
            loop.call_soon_threadsafe(often.set)

    monkeypatch.setattr(memory, "trimming", lambda: trim)
    async with giving_back(interval_s=0.0):
        await asyncio.wait_for(often.wait(), 30.0)


async def test_where_the_c_library_cannot_nothing_is_done(monkeypatch):
    monkeypatch.setattr(memory, "trimming", lambda: None)
    async with giving_back():
        pass
