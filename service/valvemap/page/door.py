"""Admission of connections: each gets a place before any byte is received or decrypted.

Places are allocated as in the OPC UA server. If all are taken, the address with the most
connections loses one: the one with the lowest `Step`. Every step has a timeout. Connections of
logged-in browsers are kept.
"""

import asyncio
import socket
import ssl
import sys
from collections import Counter
from collections.abc import Callable, MutableMapping
from contextlib import ExitStack, suppress
from enum import IntEnum
from typing import Any, assert_never

import structlog

from guarded_opcua.admission import Admission
from valvemap.clock import Clock
from valvemap.page.settings import PageSettings

log = structlog.get_logger(__name__)

_LOOK_S = 1.0  # s; interval between two checks of all connections
_CLOSING_S = 3.0  # s; timeout for the peer to read the last bytes and close its end
_NO_DESCRIPTOR_S = 0.1  # s; pause after a failed accept
_UNSENT_BYTES = 1024 * 1024  # bytes; limit of the write buffer of one viewer, pongs included
PLACE = "place"  # key in the state of a request's scope
REASONS = _CROWDED, _OVERSTAYED, _HANDSHAKE = "crowded", "overstayed", "handshake"


class Step(IntEnum):
    """Progress of a connection; the lowest is closed first."""

    CLOSING = 0  # the last bytes are being sent
    OPENING = 1  # connected, TLS handshake not complete
    SILENT = 2  # no request yet
    WAITING = 3  # answered, waiting for the next request
    ANSWERING = 4
    VIEWING = 5  # WebSocket


class Place:
    """One connection, from accept until its descriptor is closed."""

    def __init__(self, connected: socket.socket, clock: Clock) -> None:
        self._connected = connected
        self._clock = clock
        self.opened = self.since = clock.monotonic()
        self.step = Step.OPENING
        self.transport: asyncio.Transport | None = None
        self.is_logged_in = False

    @property
    def unsent(self) -> int:
        """Bytes in the write buffer."""
        return 0 if self.transport is None else self.transport.get_write_buffer_size()

    def go_to(self, step: Step) -> None:
        """Enter a step and restart its timeout."""
        self.step, self.since = step, self._clock.monotonic()

    def hang_up(self) -> None:
        """Close the connection now and discard its write buffer."""
        if self.transport is not None:
            self.transport.abort()
        else:  # fails its TLS handshake
            with suppress(OSError):
                self._connected.shutdown(socket.SHUT_RDWR)


def place_of(scope: MutableMapping[str, Any]) -> Place | None:
    """Return the place of a request's connection, None if it has none."""
    place = scope.get("state", {}).get(PLACE)
    return place if isinstance(place, Place) else None


class Door:
    """Accepts connections, allocates places and closes connections that time out.

    Parameters
    ----------
    settings
        Number of places and timeout of each step.
    clock
        Time source.

    Attributes
    ----------
    refusals : Counter
        Connections refused or closed, by reason.
    """

    def __init__(self, settings: PageSettings, clock: Clock) -> None:
        self._settings, self._clock = settings, clock
        self.refusals: Counter[str] = Counter()
        self._opening: set[asyncio.Task[None]] = set()
        self._places: Admission[Place] = Admission(
            clock,
            settings.connections,
            settings.connections_of_address,
            settings.connections_per_s,
            lambda place: (place.step, place.opened),
            lambda _newcomer: {place for place in self._places if place.is_logged_in},
            self._give_way,
        )
        self._handshaking: Admission[Place] = Admission(
            clock,
            settings.handshakes,
            settings.handshakes_of_address,
            settings.handshakes_per_s,
            lambda place: place.opened,
            lambda _newcomer: (),
            self._give_way,
        )

    def __len__(self) -> int:
        return len(self._places)

    async def open(
        self,
        listening: socket.socket,
        protocol: Callable[[Place], asyncio.Protocol],
        tls: ssl.SSLContext | None,
    ) -> None:
        """Accept until cancelled; then close all connections."""
        looking = asyncio.create_task(self._look_for_ever())
        try:
            await self._accept_for_ever(listening, protocol, tls)
        finally:
            looking.cancel()
            self.hang_up()

    def note_log_in(self, scope: MutableMapping[str, Any], *, is_logged_in: bool) -> None:
        """Note whether the browser is logged in; connections of logged-in browsers are kept."""
        place = place_of(scope)
        if place is not None:
            place.is_logged_in = is_logged_in

    def leave(self, place: Place) -> None:
        """Free the place of a closed connection."""
        self._places.leave(place)

    def hang_up(self) -> None:
        """Close all connections."""
        for place in self._places:
            place.hang_up()
        for opening in self._opening:
            opening.cancel()

    def end_overstaying(self) -> None:
        """Close connections whose step has timed out."""
        now = self._clock.monotonic()
        for place in self._places:
            is_closing = place.transport is not None and place.transport.is_closing()
            if is_closing and place.step is not Step.CLOSING:
                place.go_to(Step.CLOSING)
            if self._overstays(place, now - place.since):
                self.refusals[_OVERSTAYED] += 1
                place.hang_up()

    def _overstays(self, place: Place, lasted_s: float) -> bool:
        match place.step:
            case Step.CLOSING:
                return lasted_s > _CLOSING_S
            case Step.OPENING:
                return lasted_s > self._settings.handshake_s
            case Step.SILENT | Step.WAITING:
                return lasted_s > self._settings.request_s
            case Step.ANSWERING:
                return lasted_s > self._settings.answer_s
            case Step.VIEWING:
                return place.unsent > _UNSENT_BYTES
            case _:
                assert_never(place.step)

    async def _accept_for_ever(
        self,
        listening: socket.socket,
        protocol: Callable[[Place], asyncio.Protocol],
        tls: ssl.SSLContext | None,
    ) -> None:
        loop = asyncio.get_running_loop()
        listening.setblocking(False)  # noqa: FBT003 - as in socket
        while True:
            try:
                connected, address = await loop.sock_accept(listening)
            except OSError as error:  # the peer has gone already, or no descriptor is left
                log.warning("a connection cannot be accepted", reason=str(error))
                await asyncio.sleep(_NO_DESCRIPTOR_S)
                continue
            place, host = Place(connected, self._clock), str(address[0])
            if self._places.admit(place, host):
                opening = loop.create_task(self._open_one(place, host, connected, protocol, tls))
                self._opening.add(opening)
                opening.add_done_callback(self._opening.discard)
            else:
                self.refusals[_CROWDED] += 1
                connected.close()
            await asyncio.sleep(0)  # yield to other tasks, however many peers connect

    async def _open_one(
        self,
        place: Place,
        host: str,
        connected: socket.socket,
        protocol: Callable[[Place], asyncio.Protocol],
        tls: ssl.SSLContext | None,
    ) -> None:
        """Complete the TLS handshake, then pass the connection to the protocol."""
        loop = asyncio.get_running_loop()
        waits = (
            {}
            if tls is None
            else {
                "ssl_handshake_timeout": self._settings.handshake_s,
                "ssl_shutdown_timeout": _CLOSING_S,
            }
        )
        try:
            if tls is not None:
                await self._start_of_handshake(place, connected, host)
            await loop.connect_accepted_socket(lambda: protocol(place), connected, ssl=tls, **waits)
        except OSError:  # ssl.SSLError, ConnectionError, TimeoutError: caused by the peer
            self.refusals[_HANDSHAKE] += 1
        finally:
            self._handshaking.leave(place)
            if place.transport is None:
                self.leave(place)

    async def _start_of_handshake(self, place: Place, connected: socket.socket, host: str) -> None:
        """Wait for a first byte before starting TLS, which allocates 300 kB in asyncio.

        Raises
        ------
        OSError
        """
        with ExitStack() as failing:
            failing.callback(connected.close)  # no transport owns the socket yet
            if sys.platform != "win32":  # the Windows loop cannot wait for a byte and leave it
                await self._first_byte(connected)
            if not self._handshaking.admit(place, host):
                raise ConnectionAbortedError
            failing.pop_all()

    async def _first_byte(self, connected: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        begun = asyncio.Event()
        connected.setblocking(False)  # noqa: FBT003 - as in socket
        loop.add_reader(connected, begun.set)
        try:
            async with asyncio.timeout(self._settings.handshake_s):
                await begun.wait()
        finally:
            loop.remove_reader(connected)
        if not connected.recv(1, socket.MSG_PEEK):
            raise ConnectionAbortedError

    def _give_way(self, place: Place) -> None:
        self.refusals[_CROWDED] += 1
        place.hang_up()

    async def _look_for_ever(self) -> None:
        while True:
            await asyncio.sleep(_LOOK_S)
            self.end_overstaying()
