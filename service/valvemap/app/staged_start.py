"""Start of a service whose kernels are not compiled: its quick estimators run interpreted first.

1. `first_identification` is a preview: kernels run interpreted, and estimators that are too slow
   for this wait.
2. `Compilation` compiles all kernels in other processes.
3. `complete` builds the whole identification, which repeats every call that the preview received
   and takes over. Its state is the one of a service that had waited for the compiler.
"""

import asyncio

import structlog

from valvemap.app.build import build_identification, build_preview
from valvemap.app.warm_up import warm_up, warm_up_aside
from valvemap.config.models import Config
from valvemap.daemon_thread import in_daemon_thread
from valvemap.model.kernels import interpreted
from valvemap.model.kernels.warmed_up import was_warmed_up
from valvemap.numba_version import is_tested
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.result_ports import StartState
from valvemap.runtime.live import LiveService

log = structlog.get_logger(__name__)


def first_identification(config: Config) -> Identification:
    """Return all valves; a preview if kernels must be compiled and can be interpreted."""
    if was_warmed_up() or not is_tested():
        return build_identification(config)
    interpreted.begin()
    return build_preview(config)


class Compilation:
    """Compiles the kernels of a configuration, or loads them from the cache, in a thread.

    Attributes
    ----------
    parts
        Numbers of compiled parts and of all parts.
    is_over : bool
        Whether `stop` was called.
    """

    def __init__(self, config: Config) -> None:
        self.parts = 0, 0
        self._config = config
        self._work: asyncio.Future[None] | None = None
        self.is_over = False

    def begin(self) -> "asyncio.Future[None]":
        """Start the compilation unless it was started; return its future."""
        if self._work is None:
            self._work = in_daemon_thread(self._compile)
        return self._work

    async def ended(self) -> None:
        """Start the compilation if necessary, and wait until it is complete."""
        await asyncio.shield(self.begin())

    def stop(self) -> None:
        """Start no further part, and end the other processes."""
        self.is_over = True

    def _compile(self) -> None:
        if interpreted.is_on():
            warm_up_aside(self._config, self._note, lambda: self.is_over)
            if self.is_over:
                return
        with interpreted.compiling():  # the event loop's thread does not wait for the compiler
            warm_up(self._config, self._note, lambda: self.is_over)

    def _note(self, done: int, of: int) -> None:
        if (done, of) != self.parts and done < of:
            log.info("compiling, at the first start only", part=done + 1, of=of)
        self.parts = done, of


async def complete(config: Config, compiled: Compilation, live: LiveService) -> None:
    """Compile, and replace the service's preview by the whole identification."""
    following = asyncio.create_task(_follow(compiled, live))
    try:
        await compiled.ended()
    finally:
        following.cancel()
    if compiled.is_over:
        return
    await live.complete(await asyncio.to_thread(build_identification, config))
    interpreted.end()
    log.info("all estimators started")


async def _follow(compiled: Compilation, live: LiveService) -> None:
    """Publish the progress."""
    while True:
        done, of = compiled.parts
        live.health.start_state = StartState(
            f"compiling: {done} of {of} parts done; estimators that need compiled code wait",
            100.0 * done / max(of, 1),
        )
        await asyncio.sleep(_FOLLOW_S)


_FOLLOW_S = 0.5
