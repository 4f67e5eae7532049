"""A server that answers honestly but for one service (raw frames, SecurityPolicy None).

It stands before a real one and puts a lie in the place of every response of one kind.
"""

import asyncio
import struct
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Self

OPEN = b"OPN"
_HEAD, _SEQUENCE = 8, 8
_SYMMETRIC = 12 + 4  # header with channel, then the token


@dataclass
class Lie:
    """What is sent instead: a ``body``, or else ``frames``, as long as anybody listens."""

    kind: int  # number of the response's TypeId; 0: the Acknowledge
    body: Callable[[bytes], bytes] | None = None  # of the honest body
    frames: Callable[[bytes], Iterable[bytes]] | None = None  # of all before the body
    told: float = field(default=0.0, init=False)
    bytes_taken: int = field(default=0, init=False)


class LyingServer:
    """Listens on a free port of 127.0.0.1; honest until ``lie`` is set."""

    def __init__(self, target_port: int) -> None:
        self._target_port = target_port
        self._writers: set[asyncio.StreamWriter] = set()
        self.lie: Lie | None = None
        self.port = 0

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        for writer in self._writers:
            writer.transport.abort()
        await self._server.wait_closed()
        await asyncio.sleep(0.01)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there = await asyncio.open_connection("127.0.0.1", self._target_port)
        self._writers |= {writer, there[1]}
        await asyncio.gather(self._requests(reader, there[1]), self._responses(there[0], writer))
        self._writers -= {writer, there[1]}

    async def _requests(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while data := await reader.read(65_536):
                writer.write(data)
                await writer.drain()
        writer.close()

    async def _responses(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError, asyncio.IncompleteReadError):
            while True:
                head = await reader.readexactly(_HEAD)
                size = int.from_bytes(head[4:], "little")
                frame = head + await reader.readexactly(size - _HEAD)
                before = _before_body(frame)
                body = frame[len(before) :]
                lie = self.lie
                if lie is not None and lie.kind == _kind(frame, body):
                    lie.told = asyncio.get_running_loop().time()
                    await _tell(lie, before, body, writer)
                else:
                    writer.write(frame)
                    await writer.drain()
        writer.close()


def frame(before: bytes, body: bytes, *, claimed: int | None = None) -> bytes:
    """Return a frame; its size may be a lie."""
    size = len(before) + len(body) if claimed is None else claimed
    return before[:4] + struct.pack("<I", size) + before[8:] + body


def chunk(before: bytes, body: bytes, number: int) -> bytes:
    """Return the ``number``-th of many chunks."""
    at = len(before) - _SEQUENCE
    sequence = int.from_bytes(before[at : at + 4], "little") + number
    before = before[:3] + b"C" + before[4:at] + struct.pack("<I", sequence) + before[at + 4 :]
    return frame(before, body)


def _before_body(frame: bytes) -> bytes:
    if frame[:3] == OPEN:
        length = int.from_bytes(frame[12:16], "little")  # of the policy; no certificates
        return frame[: 12 + 4 + length + 4 + 4 + _SEQUENCE]
    if frame[:3] == b"MSG":
        return frame[: _SYMMETRIC + _SEQUENCE]
    return frame[:_HEAD]


def _kind(frame: bytes, body: bytes) -> int:
    return 0 if frame[:3] == b"ACK" else int.from_bytes(body[2:4], "little")


async def _tell(lie: Lie, before: bytes, body: bytes, writer: asyncio.StreamWriter) -> None:
    if lie.body is not None:
        lie_body = lie.body(body)
        head = before
        number = 0
        while len(lie_body) > 60_000:  # in chunks, as servers do
            writer.write(chunk(head, lie_body[:60_000], number))
            await writer.drain()
            lie_body, number = lie_body[60_000:], number + 1
        last = bytearray(chunk(head, lie_body, number))
        last[3:4] = b"F"
        writer.write(bytes(last))
        await writer.drain()
    if lie.frames is not None:
        for piece in lie.frames(before):
            writer.write(piece)
            lie.bytes_taken += len(piece)
            await writer.drain()
