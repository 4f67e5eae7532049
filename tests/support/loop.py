"""An event loop's time, turned by hand."""

from types import SimpleNamespace


class Loop:
    """Stands for asyncio's."""

    def __init__(self):
        self.now = 0.0
        self.timers = []

    def time(self):
        return self.now

    def call_at(self, when, callback):
        timer = SimpleNamespace(when=when, callback=callback, dead=False)
        timer.cancel = lambda: setattr(timer, "dead", True)
        self.timers.append(timer)
        return timer

    def call_soon(self, callback):
        return self.call_at(self.now, callback)

    def advance(self, seconds):
        end = self.now + seconds
        while due := [t for t in self.timers if not t.dead and t.when <= end]:
            timer = min(due, key=lambda t: t.when)
            self.timers.remove(timer)
            self.now = timer.when
            timer.callback()
        self.timers = [t for t in self.timers if not t.dead]
        self.now = end
