"""The live axes: data changes in, maps and the inverse for speed out, states kept."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import structlog

from valvemap.clock import Clock
from valvemap.errors import CommandRejected, SourceError, StorageError
from valvemap.model.axis import AxisSamples
from valvemap.model.samples import Times
from valvemap.pipeline.alarm_results import AlarmReport
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_arrivals import LINES, awaited, counted
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.axis_ports import AxisOperator, AxisResults, AxisSink, RequiredU
from valvemap.pipeline.axis_states import AxisStates
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.operator_ports import Command
from valvemap.pipeline.source_ports import AllSources
from valvemap.pipeline.store_ports import CheckpointStore, Piece
from valvemap.runtime.axis_work import AxisWork
from valvemap.runtime.failure_log import log_left_out, log_missing
from valvemap.runtime.feed_forward_writer import FeedForwardWriter
from valvemap.runtime.heard_axes import HeardAxes
from valvemap.runtime.kept_position import resume_source
from valvemap.runtime.led_axes import LedAxes
from valvemap.runtime.past_pieces import pieces_of
from valvemap.runtime.restoring import REMEDY, by_reason, restore
from valvemap.runtime.state_keeper import StateKeeper
from valvemap.runtime.waiting_time import WaitingTime
from valvemap.vocabulary.statuses import AxisStatus

SHOWN_S = 0.1  # s; shortest time between two results of an axis

log = structlog.get_logger(__name__)

AxisTap = Callable[[AxisOperator, str, AxisSamples], None]


class LiveAxes:
    """Implements `Consumer` of the supervisor, and `AxisOperator`.

    Rows 2k and 2k + 1 of the source are the lines A and B of axis k. An error at one axis stops
    that axis alone.

    Parameters
    ----------
    plans
        The axes.
    arrivals
        Converts the changes of all rows into samples.
    sink
        Shows the results.
    source
        Receives what feed-forward writes.
    store
        Keeps the states.
    tap
        Called with each axis' samples when they are complete, before its answers are written.
    keep
        Called with rows for the history; None: there is none.
    reorder_s, stale_after_s, checkpoint_interval_s
        Longest wait in the reorder buffer; without a sample for this long, results are stale;
        interval at which the states are saved.
    """

    def __init__(
        self,
        plans: Sequence[AxisPlan],
        arrivals: Arrivals,
        sink: AxisSink,
        source: AllSources,
        store: CheckpointStore,
        clock: Clock,
        *,
        reorder_s: float,
        stale_after_s: float,
        checkpoint_interval_s: float,
        tap: AxisTap | None = None,
        keep: Callable[[Sequence[Piece]], None] | None = None,
    ) -> None:
        now = clock.monotonic()
        self.axes = [
            Axis(plan, None if tap is None else partial(tap, self, plan.name)) for plan in plans
        ]
        self._numbers = {plan.name: number for number, plan in enumerate(plans)}
        self._arrivals, self._sink, self._clock = arrivals, sink, clock
        self._stale_after_s = stale_after_s
        self._states, self._store = AxisStates(self.axes, arrivals, self._fail), store
        self.keeper = StateKeeper(self._states, source, store, clock, checkpoint_interval_s)
        self._held = WaitingTime(LINES * len(plans), reorder_s, now)
        self._heard = HeardAxes(self.axes, arrivals, source, clock)
        self._shown_at = np.full(len(plans), -np.inf)
        self._failed: dict[int, str] = {}
        self._keep, self._kept = keep, [(0, False)] * len(plans)
        self._source = source
        self.led = LedAxes(self.axes, self._age_s, self._show, self._fail)
        self._writer = FeedForwardWriter(self.led, LINES * len(plans), source, clock)
        self._work = AxisWork(self.axes, self._show, self._fail)

    @property
    def names(self) -> list[str]:
        """Names of the axes."""
        return list(self._numbers)

    def start(self) -> None:
        """Resume from the stored states, and show every axis.

        Raises
        ------
        StorageError
            if states cannot be set aside: the next save would replace them.
        """
        stored, lost_place = resume_source(self._source, self._store.load())
        refused = {**restore(self._states, self._store, stored), **lost_place}
        self.keeper.refused = len({*refused, *self._store.damaged})
        if refused:
            log.warning(
                "checkpoints set aside, their axes are reset",
                why=by_reason(refused),
                remedy=REMEDY,
            )
        for number in range(len(self.axes)):
            self._show(number)

    async def connected(self, valves: Times | None = None, *, restarted_at: int | None) -> None:
        """Note the connection; if the source was restarted, count its samples anew."""
        rows = self._heard.rows(valves)
        self._heard.begin()
        if restarted_at is not None:
            self._use(self._arrivals.begin_source_anew(rows, restarted_at))

    async def take(self, changes: DataChanges, valves: Times | None = None) -> None:
        """Identify and show."""
        self._heard.connected[self._heard.rows(valves)] = True
        self._arrivals.announce(changes, self._clock.monotonic())
        self._use(self._arrivals.take(changes))
        await self._writer.write(self._heard.rows(valves))
        self.keeper.mark = self._source.mark

    async def tick(self, valves: Times | None = None) -> None:
        """Flush overdue samples, begin the jobs that are due, mark stale results, save states."""
        now = self._clock.monotonic()
        due = self._held.due(now, self._heard.connected, self._arrivals.waits())
        if len(due):
            self._use(self._arrivals.wait_no_longer(due))
        for number in range(len(self.axes)):
            self._begin_job(number)
            if now - self._shown_at[number] > self._stale_after_s:
                self._show(number)
        rows = self._heard.rows(valves)
        await self._writer.write(rows[self._writer.are_due(rows, now)])
        self.keeper.keep_in_turn(now)

    async def lost(
        self,
        reason: SourceError,  # noqa: ARG002 - the supervisor logs it
        valves: Times | None = None,
    ) -> None:
        """Mark the rows' source as disconnected."""
        rows = self._heard.rows(valves)
        self._heard.begin()
        self._heard.connected[rows] = False
        await self._writer.write(rows)

    async def finish(self) -> bool:
        """Save all states; a job under way is left. Returns whether they are saved."""
        await self._work.cancel()
        log_missing(self._arrivals.left_out())
        try:
            return await self.keeper.keep()
        except StorageError as error:
            log.warning("checkpoint of axes not saved", reason=str(error))
            return False

    def set_reference(self, axis: str) -> None:
        """Reset an axis: findings are relative to its state from now on."""
        number = self._number(axis)
        self.axes[number].learner.set_reference()
        log.info("reference of axis set", axis=axis)
        self._show(number)

    def arm_axis(self, axis: str, *, armed: bool) -> None:
        """Let the answer to the demand be written to the valve, or no longer."""
        number = self._number(axis)
        self.led.arm(number, armed=armed)
        self._show(number)

    def demand_speed(self, axis: str, v: float) -> None:
        """Demand a speed, mm/s; NaN withdraws the demand."""
        number = self._number(axis)
        self.axes[number].demand(v)
        self._show(number)

    def invert_speed(
        self, axis: str, v: float, pA: float, pB: float, pS: float, pT: float, T: float
    ) -> RequiredU:
        """Return the signal for a speed at these pressures and T; NaN: those of the newest."""
        return self.axes[self._number(axis)].invert(v, pA, pB, pS, pT, T)

    def alarms_of(self, axis: str) -> tuple[AlarmReport, ...]:
        """Return the state of all alarms of an axis."""
        return self.axes[self._number(axis)].alarms.reports()

    def act_on_alarm(self, command: Command) -> None:
        """Acknowledge, confirm or comment an alarm of the axis that the command names as valve."""
        number = self._number(command.valve or "")
        self.axes[number].alarms.act(command)
        self._show(number)

    def _number(self, axis: str) -> int:
        if axis not in self._numbers:
            raise CommandRejected(f"{axis}: there is no such axis any more")
        return self._numbers[axis]

    def _use(self, samples: ByValve) -> None:
        self._states.note_change()
        for row, error in self._arrivals.buffers.new_failures():
            log_left_out(self._arrivals.names[row], error)
        self._held.heard(samples.segments.members)
        now = self._clock.monotonic()
        for row, batch in samples.items():
            number, line = divmod(row, LINES)
            if number in self._failed:
                continue
            axis = self.axes[number]
            before = axis.t
            try:
                axis.take_line(line, batch)
            except Exception as error:  # noqa: BLE001 - a bulkhead: the other axes go on
                self._fail(number, error)
            if axis.t != before:  # both lines have come
                self._heard.note_sample(number)
        for number in {row // LINES for row in samples.segments.members.tolist()}:
            self._begin_job(number)
            if now - self._shown_at[number] >= SHOWN_S:
                self._show(number)

    def _begin_job(self, number: int) -> None:
        if number not in self._failed:
            self._work.begin(number)

    def _fail(self, number: int, error: Exception) -> None:
        self._failed[number] = f"{AxisStatus.FAILED.sentence} ({type(error).__name__}: {error})"
        name = self.axes[number].plan.name
        log.error("axis failed", axis=name, why=str(error), exc_info=error)

    def _age_s(self, number: int) -> float | None:
        """Age of the newest sample, s; None: nothing may be led."""
        return None if number in self._failed else self._heard.age_s(number)

    def _show(self, number: int) -> None:
        now, axis = self._clock.monotonic(), self.axes[number]
        self._shown_at[number] = now
        results = self._results(number, now)
        self._sink.show_axis(axis.plan.name, results)
        if self._keep is not None and results.t:
            stands = id(results.map), results.is_stale
            is_news, self._kept[number] = stands != self._kept[number], stands
            with_map = is_news and results.map is not None
            self._keep(pieces_of(axis.plan.name, results, with_map=with_map))

    def _results(self, number: int, now: float) -> AxisResults:
        self._states.note_change()  # alarms are judged
        is_armed, status = self.led.shown(number)
        found = replace(self.axes[number].results(), is_armed=is_armed, feed_forward=status)
        if number in self._failed:
            sentence = self._failed[number]
            found = replace(found, status=AxisStatus.FAILED, sentence=sentence, is_stale=True)
        if self._heard.is_stale(number, now, self._stale_after_s):
            found = replace(found, is_stale=True)
        alarms = self.axes[number].alarms
        alarms.judge(found, self._clock.now(), self._heard.silent_s(number, now))
        axis, arrivals = self.axes[number], self._arrivals
        has_speed, is_stale = axis.plan.has_speed, found.is_stale
        found = replace(
            found,
            alarms=alarms.reports(),
            counters=counted(arrivals, number, axis.unpaired),
            waiting=awaited(
                arrivals, self._source.remarks, number, has_speed=has_speed, is_stale=is_stale
            ),
        )
        return found if not found.is_stale else replace(found, required=RequiredU())
