"""A server of a plant with subscriptions as in OPC UA, and the source port of a client to it.

The server samples each valve, queues the samples per subscription (bounded, the oldest are
dropped), sends them as numbered messages at the publishing interval, and keeps messages (bounded)
until they are acknowledged, to send them again. The client resumes a subscription after a cut or
a restart, and fills gaps from the server's history.
"""

import asyncio
import json
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from valvemap.errors import SourceLost, SourceRejected
from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.alignment import ByValve
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.source_ports import SourceCounters
from valvemap.vocabulary.signals import MEASURED, PER_VALVE, Signal
from valvemap.vocabulary.statuses import Quality

BAD = 0x8000_0000
_CONNECTING_S = 0.05


@dataclass
class Message:
    number: int
    changes: list  # (valve, k, first signal, last signal)


@dataclass
class _Subscription:
    """What the server keeps for a client. ``held`` is delayed to the next message."""

    id: int
    next_number: int = 1
    queue: list = field(default_factory=list)  # of k
    held: list = field(default_factory=list)
    kept: list = field(default_factory=list)  # messages not acknowledged
    overflown: bool = False
    since: float = 0.0  # of the last request of a client


class Server:
    """One plant. Sample k of each of its valves is taken at (k + 1) periods."""

    def __init__(self, case, time, rng, start_ns):
        self.case, self._time, self._rng, self._start_ns = case, time, rng, start_ns
        n = int(70.0 / case.period_s)
        self.at = (np.arange(n) + 1) * case.period_s  # s, when sample k is taken
        ahead = np.zeros(n)
        numbers = (case.first_number + np.arange(n)) % 2**32
        for when, by in case.steps:
            ahead[self.at > when] += by
        self.off = np.zeros(n, np.bool_)  # samples that a server being restarted does not take
        for when, away, by in case.restarts:
            ahead[self.at > when] += by
            self.off |= (self.at > when) & (self.at <= when + away)
            later = self.at > when + away
            numbers[later] = np.arange(later.sum())
        later = np.searchsorted(self.at, case.skipped)
        self.off[later[later < n]] = True
        self.t = start_ns + np.rint((self.at + ahead) * 1e9).astype(np.int64)
        self.values, self.bad = {}, {}
        self.gone = {valve: np.zeros((n, PER_VALVE), np.bool_) for valve in case.valves}
        for first, stop, valve, signal in case.gone:
            if case.numbered or signal != Signal.SEQUENCE:
                self.gone[valve][(self.at > first) & (self.at <= stop), signal] = True
        noise = np.random.default_rng(rng.getrandbits(64))
        for valve in case.valves:
            U, dp = noise.uniform(0, 100, n), noise.uniform(0, 200, n)
            Q = 3 + 0.1 * U * np.sqrt(dp) - 0.02 * dp + noise.normal(0, 0.3, n)
            T = np.full(n, 40.0)
            columns = (U, np.full(n, 200.0), 200.0 - dp, Q, T, numbers)
            self.values[valve] = np.stack(columns, axis=1)
            self.bad[valve] = noise.random(n) < case.bad
        for first, stop, valve, signal, kind in case.retyped:
            self._change_type((self.at > first) & (self.at <= stop), valve, signal, kind)
        self.excused = {valve: set() for valve in case.valves}  # samples that it may have lost
        self.acknowledged = {valve: set() for valve in case.valves}
        self._subscriptions = {}
        self._sent = {}
        self._ids = 0
        self.cuts = (*case.cuts, *((when, away, 0.0) for when, away, _ in case.restarts))
        self._steps = (*case.steps, *((when, by) for when, _, by in case.restarts))
        self._restarts = [when for when, *_ in case.restarts]
        self._oldest = 0  # sample of the history
        self._sampled = 0
        self.longest = 0  # queue of a subscription
        self.lapsed_at = 0.0  # when a subscription last ended
        self._ended_at = None  # samples taken when a client said good-bye; None: none has

    def _change_type(self, rows, valve, signal, kind):
        """Give some samples of a node another type; values that are no numbers do not arrive."""
        match kind:
            case "Float":
                self.values[valve][rows, signal] = self.values[valve][rows, signal].astype("f4")
            case "Int16":
                self.values[valve][rows, signal] = np.rint(self.values[valve][rows, signal])
            case "String":
                self.gone[valve][rows, signal] = True
            case _:
                raise ValueError(kind)

    def ahead_s(self):
        return sum(by for when, by in self._steps if self._time.elapsed > when)

    @property
    def started(self):
        return 1 + sum(when + away <= self._time.elapsed for when, away, _ in self.case.restarts)

    def cut_at(self, now):
        """The cut under way, or None."""
        return next((c for c in self.cuts if c[0] <= now < c[0] + c[1]), None)

    def next_cut(self, now):
        return min((c[0] for c in self.cuts if c[0] > now), default=np.inf)

    def advance(self):
        """Sample until now; end subscriptions that no client has used for their lifetime."""
        now = self._time.elapsed
        for known in list(self._subscriptions.values()):
            if now - known.since > self.case.lifetime_s:
                self._end(known)
        while self._restarts and self._restarts[0] <= now:
            self._sample(self._restarts.pop(0))
            for known in list(self._subscriptions.values()):
                self._end(known)
            self._oldest = self._sampled
        self._sample(now)

    def _sample(self, now):
        first, self._sampled = self._sampled, int(np.searchsorted(self.at, now, side="right"))
        taken = [k for k in range(first, self._sampled) if not self.off[k]]
        self.excuse(
            (v, k)
            for k in range(first, self._sampled)
            for v in self.case.valves
            if self.off[k] or self.gone[v][k].any()
        )
        for known in self._subscriptions.values():
            known.queue += taken
            too_many = len(known.queue) - self.case.queue
            if too_many > 0:
                self.excuse(
                    (valve, k) for k in known.queue[:too_many] for valve in self.case.valves
                )
                self.excuse((valve, k) for valve, k, *_ in known.held)  # too late behind a gap
                del known.queue[:too_many]
                known.overflown = True
            self.longest = max(self.longest, len(known.queue))

    def excuse(self, lost):
        for valve, k in lost:
            self.excused[valve].add(k)

    def _end(self, known):
        del self._subscriptions[known.id]
        self.lapsed_at = self._time.elapsed
        self.excuse((valve, k) for k in known.queue for valve in self.case.valves)
        self.excuse((valve, k) for valve, k, *_ in known.held)
        for message in known.kept:
            self.excuse((valve, k) for valve, k, *_ in message.changes)

    def undelivered(self):
        """The samples (valve, k) that wait for a client, or for its acknowledgement."""
        self.advance()
        for known in self._subscriptions.values():
            yield from ((valve, k) for k in known.queue for valve in self.case.valves)
            yield from ((valve, k) for valve, k, *_ in known.held)
            for message in known.kept:
                yield from ((valve, k) for valve, k, *_ in message.changes)

    def end(self, number):
        """A client deletes its subscription."""
        self.advance()
        self._ended_at = 0  # it has lapsed: samples since then are in no queue
        if number in self._subscriptions:
            self._ended_at = self._sampled
            self._end(self._subscriptions[number])

    @property
    def subscribed(self):
        """Number of samples of each valve until now, or until the client's good-bye; else 0."""
        return self.taken if self._ended_at is None else self._ended_at

    def subscribe(self):
        self.advance()
        self._ids, self._ended_at = self._ids + 1, None
        known = _Subscription(self._ids, since=self._time.elapsed)
        self._subscriptions[known.id] = known
        return known.id

    def republish(self, number, first):
        """The kept messages from one on, or None if the subscription is no more."""
        self.advance()
        known = self._subscriptions.get(number)
        if known is None:
            return None
        known.since = self._time.elapsed
        return [message for message in known.kept if message.number >= first], known.next_number

    def acknowledge(self, number, last):
        known = self._subscriptions.get(number)
        while known is not None and known.kept and known.kept[0].number <= last:
            for valve, k, *_ in known.kept.pop(0).changes:
                self.acknowledged[valve].add(k)

    def sent_up_to(self, number, last):
        """Samples (valve, k) of the messages of a subscription up to one."""
        every = [sent for (of, m), sent in self._sent.items() if of == number and m <= last]
        return set().union(*every)

    def publish(self, number):
        """The next message, whether samples before it were dropped, or None without news."""
        self.advance()
        known = self._subscriptions.get(number)
        if known is None:
            raise SourceLost("no such subscription")
        known.since = self._time.elapsed
        samples, known.queue = known.queue, []
        changes, known.held = known.held, []
        for k in samples:
            for valve in self.case.valves:
                self._send(known, changes, valve, k)
        if not changes:
            return None
        message = Message(known.next_number, changes)
        known.next_number += 1
        known.kept.append(message)
        self._sent[known.id, message.number] = {change[:2] for change in changes}
        if len(known.kept) > self.case.messages:
            for valve, k, *_ in known.kept.pop(0).changes:
                self.excused[valve].add(k)
        overflown, known.overflown = known.overflown, False
        return message, overflown

    def _send(self, known, changes, valve, k):
        whole, rng, case = (valve, k, 0, PER_VALVE), self._rng, self.case
        is_new = self._time.elapsed - self.at[k] < case.publishing_s
        if is_new and rng.random() < case.late:
            known.held.append(whole)
            return
        if is_new and rng.random() < case.split:
            edge = rng.randrange(1, PER_VALVE)
            changes.append((valve, k, 0, edge))
            known.held.append((valve, k, edge, PER_VALVE))
            return
        changes.append(whole)
        if rng.random() < case.duplicated:
            changes.append(rng.choice(changes))

    def remembered(self, first, stop):
        """The samples of the history from ``first`` on, before ``stop``."""
        oldest = max(first, self._sampled - self.case.history, self._oldest)
        return [k for k in range(oldest, min(stop, self._sampled)) if not self.off[k]]

    @property
    def taken(self):
        """Number of samples of each valve until now."""
        self.advance()
        return self._sampled

    def as_changes(self, parts, numbered_here, gains):
        """The parts of samples as data changes; valves have their numbers at this source.

        ``gains`` (PER_VALVE,) by valve: the configured units.
        """
        item, value, status, t = [], [], [], []
        for valve, k, first, stop in parts:
            here = numbered_here[valve] * PER_VALVE
            last = stop if self.case.numbered else min(stop, PER_VALVE - 1)
            for signal in range(first, last):
                if self.gone[valve][k, signal]:
                    continue
                item.append(here + signal)
                value.append(self.values[valve][k, signal] * gains[valve][signal])
                status.append(BAD if signal == Signal.Q and self.bad[valve][k] else 0)
                t.append(self.t[k])
        return DataChanges(
            np.array(item, np.int32),
            np.array(value, np.float64),
            np.array(status, np.uint32),
            np.array(t, np.int64),
        )

    def as_samples(self, valve, rows, gains):
        """Samples of one valve, as aligned."""
        k = np.array(rows)
        columns = dict(zip(MEASURED, (self.values[valve][k] * gains).T, strict=False))
        quality = np.where(self.bad[valve][k], Quality.BAD, Quality.GOOD).astype(np.uint8)
        ends = np.array([valve]), np.array([0]), np.array([len(k)])
        return ByValve(Samples(t=self.t[k], quality=quality, **columns), Segments(*ends))


class Client:
    """One process's client: fulfils `valvemap.runtime.sources.SourceWithHeir`."""

    def __init__(self, server, time, plant):
        self.server, self._time = server, time
        self._gains = {valve: plant[valve].gains for valve in server.case.valves}
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
        """A client that says good-bye deletes its subscription."""
        if self._connected and self.alive:
            self.server.end(self._subscription)
        self._connected = False

    async def check(self):
        pass

    def succeed(self, before):
        raise NotImplementedError
