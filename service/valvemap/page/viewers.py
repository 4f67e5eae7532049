"""Open pages: the valves each watches, and the updates each has not received yet.

A slow viewer gets fewer and newer values. There is no queue for each viewer: messages are built
from the store at the time of sending. A viewer that reads nothing for long is disconnected.
"""

import asyncio
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import count
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from guarded_opcua.admission import Admission
from valvemap.clock import Clock
from valvemap.page.answering import Answering, request_of
from valvemap.page.greeting import greeting
from valvemap.page.layout import Part, Valve, part_of
from valvemap.page.messages import pack_rows, pack_text
from valvemap.page.observer import Observer
from valvemap.page.packing import Packing
from valvemap.page.ports import Wanted
from valvemap.page.questions import Senseless, answer_to
from valvemap.page.rates import TokenBucket
from valvemap.page.viewer import Viewer

_SLOW_READER_S = 10.0  # s; timeout of sending one message
_OPENED_PER_S = 50  # WebSockets of one address a second; starting a wall of screens opens some 20
_MESSAGES_PER_S, _BURST = 20.0, 60.0  # messages a second: more than dragging a slider sends
_POLICY_VIOLATION, _TRY_AGAIN_LATER = 1008, 1013  # close codes, RFC 6455 and IANA


class Viewers:
    """All open pages.

    Beyond the limits, the address with the most viewers loses one: the newest, or first one
    without a request. A viewer with a request is kept, unless its address has more viewers than
    the newcomer's would have.

    Parameters
    ----------
    most, most_of_address
        Viewers, in total and of one address.
    clock
        Time source.
    """

    def __init__(self, most: int, most_of_address: int, clock: Clock) -> None:
        self._open: Admission[Viewer] = Admission(
            clock,
            most,
            most_of_address,
            _OPENED_PER_S,
            lambda viewer: (viewer.has_asked, -viewer.number),
            self._staying,
            lambda viewer: viewer.gives_way.set(),
        )
        self._numbers = count(1)
        self._packing = Packing()
        self.refused = 0
        self.senseless = 0

    def __len__(self) -> int:
        return len(self._open)

    def wake(self) -> None:
        """Let all viewers check for updates."""
        for viewer in self._open:
            viewer.changed.set()

    def wanted(self, places: Sequence[Valve | Part]) -> Wanted:
        """Return the valves, parts and maps in view on any page."""
        numbers = {place.name: number for number, place in enumerate(places)}
        wanted = Wanted()
        for viewer in self._open:
            number = numbers.get(viewer.watched or "")
            if number is None:
                continue
            place = places[number]
            if part_of(place) is not None:
                wanted.parts.add(number)
            if isinstance(place, Part):
                continue
            (wanted.from_afar if viewer.from_afar else wanted.live).add(number)
            if viewer.estimator in place.estimators:
                wanted.maps.add((number, viewer.estimator))
        return wanted

    async def serve(self, socket: WebSocket, observer: Observer) -> None:
        """Serve one page until it disconnects."""
        viewer = Viewer(socket, next(self._numbers))
        if not self._open.admit(viewer, _host_of(viewer)):
            self.refused += 1
            await socket.close(_TRY_AGAIN_LATER)
            return
        try:
            await self._talk(viewer, observer)
        finally:
            self._open.leave(viewer)

    async def _talk(self, viewer: Viewer, observer: Observer) -> None:
        await viewer.socket.accept()
        viewer.changed.set()
        tasks = [
            asyncio.create_task(talk)
            for talk in (
                self._send_for_ever(viewer, observer),
                self._listen(viewer, observer),
                viewer.gives_way.wait(),
            )
        ]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            self._open.leave(viewer)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            if viewer.gives_way.is_set():
                self.refused += 1
            if viewer.socket.client_state is WebSocketState.CONNECTED:
                with suppress(RuntimeError, OSError):
                    await viewer.socket.close(
                        _TRY_AGAIN_LATER if viewer.gives_way.is_set() else _POLICY_VIOLATION
                    )

    def _staying(self, newcomer: Viewer) -> frozenset[Viewer]:
        """Viewers with a request, whose address holds no more viewers than the newcomer's would."""
        fair = self._open.held_at(_host_of(newcomer)) + 1
        return frozenset(
            viewer
            for viewer in self._open
            if viewer.has_asked and self._open.held_at(_host_of(viewer)) <= fair
        )

    async def _listen(self, viewer: Viewer, observer: Observer) -> None:
        """Take requests until the viewer leaves or sends an invalid one."""

        async def answer(number: int, question: dict[str, Any]) -> None:
            await self._send(viewer, await answer_to(observer, number, question))

        answering = Answering(answer)
        try:
            listening = self._take_requests(viewer, answering)
            await answering.until_one_fails(listening)
        except Senseless:
            self.senseless += 1
        except WebSocketDisconnect:
            pass

    async def _take_requests(self, viewer: Viewer, answering: Answering) -> None:
        bucket = TokenBucket(_MESSAGES_PER_S, _BURST)
        while True:
            message = await viewer.socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            request = request_of(message.get("text") if bucket.take() else None)
            await self._take(viewer, answering, request)

    async def _take(self, viewer: Viewer, answering: Answering, request: dict[str, Any]) -> None:
        match request:
            case {
                "watch": {
                    "valve": str() | None as valve,
                    "estimator": str() | None as estimator,
                    "overview": bool() as overview,
                    **more,
                }
            }:
                if valve != viewer.watched or estimator != viewer.estimator:
                    viewer.seen = 0
                viewer.watched, viewer.estimator = valve, estimator
                viewer.from_afar = more.get("fromAfar") is True
                viewer.has_asked = True
                viewer.overview = overview
                viewer.rows_seen.clear()
                viewer.changed.set()
            case {"ask": int() as number, **question}:
                await answering.take(number, question)
            case _:
                raise Senseless

    async def _send_for_ever(self, viewer: Viewer, observer: Observer) -> None:
        with suppress(WebSocketDisconnect, RuntimeError, OSError, TimeoutError):
            while True:
                await viewer.changed.wait()
                viewer.changed.clear()
                for message in self._unseen(viewer, observer):
                    await self._send(viewer, message)

    async def _send(self, viewer: Viewer, message: str | bytes) -> None:
        async with asyncio.timeout(_SLOW_READER_S):
            if isinstance(message, str):
                await viewer.socket.send_text(message)
            else:
                await viewer.socket.send_bytes(message)

    def _unseen(self, viewer: Viewer, observer: Observer) -> Iterator[str | bytes]:
        """Yield messages with all updates this viewer has not received yet."""
        link = observer.link.value, observer.link_text
        present = (observer.generation, *link, observer.start)
        if viewer.greeted != present:
            if viewer.greeted is None or viewer.greeted[0] != present[0]:
                viewer.seen = 0
                viewer.rows_seen.clear()
            viewer.greeted = present
            yield pack_text(greeting(observer))
        events = observer.time_line.after(viewer.events_seen)
        if events:
            viewer.events_seen = events[-1].number
            yield pack_text(
                {
                    "events": [
                        [e.number, e.t / 1e6, e.valve, e.kind, int(e.severity), e.text]
                        for e in events
                    ]
                }
            )
        if viewer.alarms_seen != observer.alarms.revision:
            viewer.alarms_seen = observer.alarms.revision
            alarms = observer.alarms
            yield pack_text(
                {"alarms": alarms.rows(), "of": len(alarms.present), "trouble": alarms.trouble}
            )
        if viewer.overview:
            yield from self._new_rows(viewer, observer)
        numbers = {place.name: number for number, place in enumerate(observer.places)}
        number = numbers.get(viewer.watched or "")
        if number is not None:
            yield from self._new_values(viewer, observer, number)

    def _new_rows(self, viewer: Viewer, observer: Observer) -> Iterator[bytes]:
        new = [
            (number, row)
            for number, row in observer.standings.rows.items()
            if viewer.rows_seen.get(number) is not row
        ]
        if new:
            viewer.rows_seen.update(new)
            yield pack_rows(
                [number for number, _ in new],
                [
                    (
                        r.reason.severity,
                        r.reason,
                        r.since / 1e6,
                        r.rmse,
                        r.noise,
                        r.samples,
                        r.silent_s,
                        r.predicted,
                        r.health,
                    )
                    for _, r in new
                ],
            )

    def _new_values(self, viewer: Viewer, observer: Observer, number: int) -> Sequence[str | bytes]:
        packed = self._packing.values(observer.store, number, viewer.seen, viewer.names_seen)
        viewer.seen, viewer.names_seen = observer.store.revision, self._packing.names
        return packed


def _host_of(viewer: Viewer) -> str:
    return viewer.socket.client.host if viewer.socket.client else ""
