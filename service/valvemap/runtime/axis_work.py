"""The long computations of axes: one at a time, in a thread, while samples are taken."""

import asyncio
from collections.abc import Callable, Sequence

import structlog

from valvemap.daemon_thread import in_daemon_thread
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_jobs import Job

log = structlog.get_logger(__name__)


class AxisWork:
    """Does the jobs that the learners of axes have due.

    Parameters
    ----------
    axes
        The axes.
    show
        Called with an axis whose job has ended.
    fail
        Called with an axis whose job has raised, before it is shown.
    """

    def __init__(
        self,
        axes: Sequence[Axis],
        show: Callable[[int], None],
        fail: Callable[[int, Exception], None],
    ) -> None:
        self._axes, self._show, self._fail = axes, show, fail
        self._tasks: dict[int, asyncio.Task[None]] = {}
        self._one_at_a_time = asyncio.Semaphore(1)

    def begin(self, number: int) -> None:
        """Begin the job of an axis, if one is due."""
        job = self._axes[number].learner.job()
        if job is not None:
            self._tasks[number] = asyncio.create_task(self._do(number, job))

    async def cancel(self) -> None:
        """Abandon the jobs under way."""
        for task in self._tasks.values():
            task.cancel()
        await asyncio.gather(*self._tasks.values(), return_exceptions=True)

    async def _do(self, number: int, job: Job) -> None:
        axis, before = self._axes[number], self._axes[number].results()
        async with self._one_at_a_time:
            try:
                axis.learner.accept(await in_daemon_thread(job))
            except asyncio.CancelledError:
                axis.learner.abandon()
                raise
            except Exception as error:  # noqa: BLE001 - a bulkhead: the other axes continue
                axis.learner.abandon()
                self._fail(number, error)
        self._show(number)
        after = axis.results()
        if (before.status, before.map is None) != (after.status, after.map is None):
            log.info("axis", axis=axis.plan.name, status=after.status.label, why=after.sentence)
