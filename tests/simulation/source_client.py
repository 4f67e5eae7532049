"""The source port of a client to a simulated server.

It resumes a subscription after a cut or a restart, and fills gaps from the server's history.
"""

import asyncio
import json
from typing import ClassVar

from valvemap.errors import SourceLost, SourceRejected
from valvemap.pipeline.source_ports import SourceCounters
from valvemap.vocabulary.signals import PER_VALVE

_CONNECTING_S = 0.05


class Client:
    """One process's client: fulfils `valvemap.runtime.sources.SourceWithHeir`."""

    def __init__(self, server, time, plant):
        self.server, self._time = server, time
        self.configure(plant)
        self._heir, self._has_inherited = None, False
        self.resumes_behind = set()  # samples (valve, k) before the position that was resumed
        self._here = {valve: n for n, valve in enumerate(server.case.valves)}
        self._holds_back = False
        self._connected = False
        self._subscription = None  # id, kept over cuts
        self._message = 0  # number of the last returned message
        self._known = -1  # newest sample returned
        self._parts = []  # messages received, not returned yet: (message, behind a gap)
        self._doubtful = False  # whether samples may be missing before the next message
        self._due = 0.0
        self.started = 0  # as read on connecting, or of the position that is resumed
        self.mark = None
        self.alive = True
        self._overflows = 0
        self.leading = None  # who judges what is written

    def configure(self, plant):
        """Take the scaling of each signal from a configuration."""
        self._gains = {valve: plant[valve].gains for valve in self.server.case.valves}

    is_held = True
    remarks: ClassVar = {}

    @property
    def counters(self):
        return SourceCounters(overflows=self._overflows)

    @property
    def clock_offset_s(self):
        return self.server.ahead_s() - self._time.service_ahead_s

    @property
    def delivers(self):
        """Whether its subscription runs, and a message has come since it was connected."""
        return self._connected and not self._doubtful

    def hold_back(self):
        self._holds_back = True

    def commit(self, mark):
        if self._connected and self.alive:
            self.server.acknowledge(*mark[:2])

    def position(self, mark):
        return json.dumps(mark).encode()

    def resume_at(self, position):
        if self._has_inherited:  # a later position than the stored one
            return True
        self._subscription, self._message, self._known, self.started = json.loads(position)
        self.resumes_behind = self.server.sent_up_to(self._subscription, self._message)
        return True

    async def connect(self):
        await asyncio.sleep(_CONNECTING_S)
        if self.server.cut_at(self._time.elapsed):
            raise SourceLost("refused")
        self.started = self.server.started
        newest = self._parts[-1][0].number if self._parts else self._message
        found = None
        if self._subscription is not None:
            found = self.server.republish(self._subscription, newest + 1)
        if found is None:
            self._message = 0
            self._subscription = self.server.subscribe()
            self._doubtful = True
        else:
            messages, following = found
            first = messages[0].number if messages else following
            self._doubtful |= first > newest + 1
            for message in messages:
                self._received(message, overflown=False)
        self._connected = True
        self._due = self._time.elapsed + self.server.case.publishing_s

    async def receive(self):
        while not self._parts:
            if not self._connected:
                raise SourceLost("not connected")
            await self._arrival()
        return self._returned()

    async def _arrival(self):
        """Wait for the next message; raises when a cut is noticed."""
        now = self._time.elapsed
        cut = self.server.cut_at(now)
        begins = self.server.next_cut(now)
        if cut is None and begins >= self._due:
            await asyncio.sleep(max(self._due - now, 0.0))
            self._due = max(self._due, self._time.elapsed) + self.server.case.publishing_s
            if self.server.cut_at(self._time.elapsed) is None:
                self._hear()
            return
        if cut is None:
            await asyncio.sleep(begins - now)
            self.server.publish(self._subscription)  # sent, and lost on its way
            cut = self.server.cut_at(self._time.elapsed)
        await asyncio.sleep(0.0 if cut is None else cut[2])
        self._connected = False
        raise SourceLost("cut")

    def _hear(self):
        found = self.server.publish(self._subscription)
        if found is not None:
            self._received(*found)

    def _received(self, message, overflown):
        self._overflows += overflown
        self._parts.append((message, overflown or self._doubtful))
        self._doubtful = False

    def _returned(self):
        """All received messages, each behind what the history has of a gap before it."""
        parts = []
        for message, behind_gap in self._parts:
            if behind_gap:
                stop = min((k for _, k, *_ in message.changes if k > self._known), default=0)
                every = self.server.case.valves
                gap = self.server.remembered(self._known + 1, stop)
                missed = range(self._known + 1, stop)
                self.server.excuse((valve, k) for k in missed if k not in gap for valve in every)
                parts += [(valve, k, 0, PER_VALVE) for k in gap for valve in every]
            parts += message.changes
            self._message = message.number
            self._known = max(self._known, *(k for _, k, *_ in message.changes))
        self._parts = []
        self.mark = (self._subscription, self._message, self._known, self.started)
        if not self._holds_back:
            self.commit(self.mark)
        return self.server.as_changes(parts, self._here, self._gains)

    async def write_required_U(self, here, U):
        self._check_writable()
        self.leading.wrote_U(self.server.case.valves[here], U)

    async def write_heartbeat(self, here, count):
        self._check_writable()
        self.leading.beat(self.server.case.valves[here], count)

    def _check_writable(self):
        now = self._time.elapsed
        if not (self._connected and self.alive) or self.server.cut_at(now) is not None:
            raise SourceLost("not connected")
        if any(first <= now < stop for first, stop in self.server.case.refusals):
            raise SourceRejected("not writable now")

    async def drop(self):
        self._connected = False
        if self.leading is not None:
            self.leading.lost(self.server.case.valves)

    async def close(self):
        """A client that says good-bye deletes its subscription, or leaves it to its heir."""
        if self._heir is not None:
            self._heir._inherit(self)
        elif self._connected and self.alive:
            self.server.end(self._subscription)
        self._connected = False

    async def check(self):
        pass

    def succeed(self, before):
        before._heir = self

    def _inherit(self, before):
        kept = ("_subscription", "_message", "_known", "_parts", "_doubtful", "_overflows")
        for name in (*kept, "started"):
            setattr(self, name, getattr(before, name))
        self._has_inherited = True
        self.resumes_behind = self.server.sent_up_to(self._subscription, self._message)

    @property
    def due_s(self):
        """Time until the next message, s."""
        return max(self._due - self._time.elapsed, 0.0)
