"""The live page of a demo: a process of its own that ends with it."""

import asyncio
import importlib.util
import os
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

_START_S = 60.0
_FAREWELL_S = 10.0
_NEEDED = ("starlette", "uvicorn", "websockets", "prometheus_client")


@asynccontextmanager
async def page_process(service_url: str, rig_url: str) -> AsyncIterator[str]:
    """Serve the page; yields its URL, or why there is none. A demo goes on without."""
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        yield f"none: {missing[0]} is missing, pip install 'valvemap[dashboard]'"
        return
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        *("-m", "service", "dashboard", "--under-demo", "--security", "None"),
        *("--url", service_url, "--rig-url", rig_url),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert process.stdin is not None  # noqa: S101 - both are pipes
    assert process.stdout is not None  # noqa: S101
    try:
        yield await _first_line(process.stdout) or "none: it did not start"
    finally:
        process.stdin.close()
        try:
            await asyncio.wait_for(process.wait(), _FAREWELL_S)
        except TimeoutError:
            process.kill()
            await process.wait()


async def _first_line(output: asyncio.StreamReader) -> str:
    try:
        return (await asyncio.wait_for(output.readline(), _START_S)).decode().strip()
    except TimeoutError:
        return ""
