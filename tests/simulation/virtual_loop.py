"""An event loop on simulated time: when every task waits, the time jumps to the next timer."""

import asyncio
import heapq
from contextlib import contextmanager

_STEPS = 200_000  # turns of the loop without a timer: a task that never waits


class VirtualTime:
    """The times of one simulated world, in s since its start; they survive a process."""

    def __init__(self, start_ns):
        self.elapsed = 0.0
        self.service_ahead_s = 0.0  # of the service's time of day
        self._start_ns = start_ns

    def now(self):
        return self._start_ns + round((self.elapsed + self.service_ahead_s) * 1e9)

    def monotonic(self):
        return self.elapsed


class DeadlockError(Exception):
    """All tasks wait, and no timer will ever end one of them."""


class VirtualLoop(asyncio.BaseEventLoop):
    """One process. Work for a thread runs inline, ``thread_takes()`` = (before, after) s around."""

    def __init__(self, time, thread_takes):
        super().__init__()
        self._virtual = time
        self._turns = 0  # since the time was set forward
        self._thread_takes = thread_takes
        self._clock_resolution = 1e-9

    def time(self):
        return self._virtual.elapsed

    def run_in_executor(self, executor, func, *args):
        done = self.create_future()
        before, after = self._thread_takes()

        def settle(call, value):
            if not done.done():
                call(value)

        def work():
            if done.cancelled():
                return
            try:
                found = func(*args)
            except Exception as error:  # noqa: BLE001 - it is raised where the future is awaited
                self.call_later(after, settle, done.set_exception, error)
            else:
                self.call_later(after, settle, done.set_result, found)

        self.call_later(before, work)
        return done

    def _run_once(self):
        """One turn, as asyncio's: in its order, without files, threads and debugging."""
        ready, scheduled, time = self._ready, self._scheduled, self._virtual
        while scheduled and scheduled[0]._cancelled:
            heapq.heappop(scheduled)._scheduled = False
        self._turns += 1
        if not (ready or self._stopping):
            if not scheduled:
                raise DeadlockError
            wait = scheduled[0]._when - time.elapsed
            if wait > 0.0:
                time.elapsed += wait
                self._turns = 0
        if self._turns > _STEPS:
            raise DeadlockError
        until = time.elapsed + self._clock_resolution
        while scheduled and scheduled[0]._when < until:
            handle = heapq.heappop(scheduled)
            handle._scheduled = False
            ready.append(handle)
        for _ in range(len(ready)):
            handle = ready.popleft()
            if not handle._cancelled:
                handle._run()

    def call_soon(self, callback, *args, context=None):
        handle = asyncio.Handle(callback, args, self, context)
        self._ready.append(handle)
        return handle

    def call_at(self, when, callback, *args, context=None):
        timer = asyncio.TimerHandle(when, callback, args, self, context)
        heapq.heappush(self._scheduled, timer)
        timer._scheduled = True
        return timer

    def _timer_handle_cancelled(self, handle):
        pass

    def _write_to_self(self):
        pass


@contextmanager
def process(time, thread_takes):
    """A process in the virtual time; at its end all its tasks are cancelled."""
    loop = VirtualLoop(time, thread_takes)
    asyncio.set_event_loop(None)
    try:
        yield loop
    finally:
        tasks = asyncio.all_tasks(loop)
        for task in tasks:
            task.cancel()
        if tasks:
            loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
        loop.close()
