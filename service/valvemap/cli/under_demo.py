"""Child processes of a demo, rig and page, which end with it."""

import asyncio
import importlib.util
import os
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from guarded_opcua import ServerError

OnLine = Callable[[str], None]
_RIG_START_S, _PAGE_START_S = 120.0, 60.0
_FAREWELL_S = 10.0
_NEEDED = ("starlette", "uvicorn", "websockets", "prometheus_client")


@asynccontextmanager
async def rig_process(
    url: str, scenario: str, password: str, on_line: OnLine
) -> AsyncIterator[str]:
    """Run the rig; yields its URL. Later lines of its output are passed to ``on_line``.

    Raises
    ------
    ServerError
        if the rig does not start; its output gives the reason.
    """
    arguments = ("rig", "--scenario", scenario, "--url", url)
    async with _process(arguments, f"{password}\n", _RIG_START_S, on_line) as line:
        if not line:
            raise ServerError("the rig did not start")
        yield line


@asynccontextmanager
async def page_process(service_url: str, rig_url: str) -> AsyncIterator[str]:
    """Serve the page; yields its URL, or the reason why it is not available."""
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        yield f"none: {missing[0]} is missing, pip install 'valvemap[dashboard]'"
        return
    arguments = ("dashboard", "--security", "None", "--url", service_url, "--rig-url", rig_url)
    async with _process(arguments, "", _PAGE_START_S, lambda _: None) as line:
        yield line or "none: it did not start"


@asynccontextmanager
async def _process(
    arguments: tuple[str, ...], said: str, start_s: float, on_line: OnLine
) -> AsyncIterator[str]:
    """Run a valvemap command that ends with this process; yields its first line, or ""."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        *("-m", "valvemap", *arguments, "--under-demo"),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert process.stdin is not None  # noqa: S101 - both are pipes
    assert process.stdout is not None  # noqa: S101
    hearing = None
    try:
        process.stdin.write(said.encode())
        first = await _first_line(process.stdout, start_s)
        hearing = asyncio.ensure_future(_hear(process.stdout, on_line))
        yield first
    finally:
        process.stdin.close()
        if hearing is not None:
            hearing.cancel()
        try:
            await asyncio.wait_for(process.wait(), _FAREWELL_S)
        except TimeoutError:
            process.kill()
            await process.wait()


async def _hear(output: asyncio.StreamReader, on_line: OnLine) -> None:
    while line := await output.readline():
        on_line(line.decode("utf-8", "replace").strip())


async def _first_line(output: asyncio.StreamReader, start_s: float) -> str:
    try:
        return (await asyncio.wait_for(output.readline(), start_s)).decode().strip()
    except TimeoutError:
        return ""
