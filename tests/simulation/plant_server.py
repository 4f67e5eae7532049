"""A server of a plant with subscriptions as in OPC UA.

The server samples each valve, queues the samples per subscription (bounded, the oldest are
dropped), sends them as numbered messages at the publishing interval, and keeps messages (bounded)
until they are acknowledged, to send them again.
"""

from dataclasses import dataclass, field

import numpy as np

from valvemap.errors import SourceLost
from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.data_changes import DataChanges
from valvemap.vocabulary.signals import MEASURED, PER_VALVE, Signal
from valvemap.vocabulary.statuses import Quality

BAD = 0x8000_0000
_Q = int(Signal.Q)


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
        self._lacks = {valve: gone.any(axis=1) for valve, gone in self.gone.items()}
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
        now = self._time.elapsed
        return sum([by for when, by in self._steps if now > when]) if self._steps else 0

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
        while True:
            oldest = min(self._subscriptions.values(), key=lambda one: one.since, default=None)
            lapse = np.inf if oldest is None else oldest.since + self.case.lifetime_s
            restart = min(self._restarts, default=np.inf)
            if restart <= min(now, lapse):
                self._sample(self._restarts.pop(0))
                for known in list(self._subscriptions.values()):
                    self._end(known)
                self._oldest = self._sampled
            elif lapse < now:
                self._sample(lapse)  # until then, into its queue
                self._end(oldest)
            else:
                return self._sample(now)

    def _sample(self, now):
        first, self._sampled = self._sampled, int(np.searchsorted(self.at, now, side="right"))
        taken = [k for k in range(first, self._sampled) if not self.off[k]]
        self.excuse(
            (v, k)
            for k in range(first, self._sampled)
            for v in self.case.valves
            if self.off[k] or self._lacks[v][k]
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
            values = (self.values[valve][k] * gains[valve]).tolist()
            gone, bad, time = self.gone[valve][k].tolist(), self.bad[valve][k], self.t[k]
            for signal in range(first, last):
                if gone[signal]:
                    continue
                item.append(here + signal)
                value.append(values[signal])
                status.append(BAD if bad and signal == _Q else 0)
                t.append(time)
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
