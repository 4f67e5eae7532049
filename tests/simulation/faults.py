"""Faults planted in the real service, to prove that the simulation finds each of them."""

import asyncio
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace
from unittest import mock

from guarded_opcua.history.historian import Span
from simulation.reload_faults import RELOAD_FAULTS
from simulation.stores import StateFile
from valvemap.errors import StorageError
from valvemap.pipeline import feedforward
from valvemap.pipeline.alignment import COUNTER_NAMES
from valvemap.pipeline.armed_valves import ArmedValves
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_states import AxisStates, AxisTerms
from valvemap.pipeline.edges import NEVER_MET
from valvemap.pipeline.edges import kernel as edges_kernel
from valvemap.pipeline.estimator_commands import EstimatorCommands
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.kept_states import MEMORY, KeptStates
from valvemap.pipeline.kept_together import KeptValves
from valvemap.runtime import sources as sources_module
from valvemap.runtime import supervisor
from valvemap.runtime.doubted_valves import DoubtedValves
from valvemap.runtime.live import LiveService
from valvemap.runtime.past import PastKeeper
from valvemap.runtime.state_keeper import StateKeeper
from valvemap.storage import state_lock


def an_early_acknowledgement():
    """Messages are acknowledged before their states are saved."""
    return _acknowledged_early(KeptValves)


def _acknowledged_early(states):
    keep = StateKeeper._keep

    async def early(self, valves, mark):
        if mark is not None and isinstance(self._states, states):
            self._source.commit(mark)
        await keep(self, valves, mark)

    return mock.patch.object(StateKeeper, "_keep", early)


def a_lost_sync():
    """Commits are in memory alone."""
    return mock.patch.object(StateFile, "sync", return_value=None)


def a_missing_lock():
    """Two sources call the consumer at the same time."""
    without = SimpleNamespace(**{**vars(asyncio), "Lock": _NoLock})
    return mock.patch.object(sources_module, "asyncio", without)


def a_state_file_without_lock():
    """Two services use one state file."""
    return mock.patch.object(state_lock.fcntl, "flock", return_value=None)


class _NoLock:
    async def __aenter__(self):
        pass

    async def __aexit__(self, *_):
        pass


def an_acknowledgement_after_a_refused_save():
    """After a refused save the messages are acknowledged all the same."""
    save = StateFile.save

    def silent(self, checkpoints):
        with suppress(StorageError):
            save(self, checkpoints)

    return mock.patch.object(StateFile, "save", silent)


def a_save_without_transaction():
    """A refused save leaves some of its rows."""
    save = StateFile.save

    def torn(self, checkpoints):
        if self.refuses and checkpoints:
            one = checkpoints[-1]
            self.committed = self.committed | {(one.valve, one.estimator): one}
            self.durable = self.committed
        save(self, checkpoints)

    return mock.patch.object(StateFile, "save", torn)


def a_forgotten_counter():
    """Rows that found no room are not counted."""
    room = PastKeeper._has_room

    def uncounted(self, rows):
        before = self.lost
        found = room(self, rows)
        self.lost = before
        return found

    return mock.patch.object(PastKeeper, "_has_room", uncounted)


def a_buffer_without_bound():
    """The history's buffer grows for as long as the disk is full or slow."""
    return mock.patch.object(PastKeeper, "_has_room", _always)


def _always(self, rows):
    self._rows += rows
    return True


def a_memory_that_is_not_restored():
    """Waiting samples, and the numbers of those learnt, are forgotten in a restart."""
    load = StateFile.load
    return mock.patch.object(
        StateFile, "load", lambda self, *_: [one for one in load(self) if one.estimator != MEMORY]
    )


def old_results_that_stay_good():
    """Silence of the sensors is not published."""

    async def never(self, *_):
        pass

    return mock.patch.multiple(DoubtedValves, doubt=never, doubt_old=never, lose=never)


def a_batch_dropped_at_the_end_of_a_connection():
    """Every tenth batch is dropped, though its mark is kept."""
    take, count = LiveService.take, iter(range(10**9))

    async def dropping(self, changes, valves=None):
        await take(self, changes[:0] if next(count) % 10 == 9 else changes, valves)

    return mock.patch.object(LiveService, "take", dropping)


def rows_lost_between_buffer_and_disk():
    """Rows that arrive while the disk is written are dropped with the saved ones."""
    keep = PastKeeper._keep

    async def dropping(self, **options):
        await keep(self, **options)
        self._samples, self._results = [], []

    return mock.patch.object(PastKeeper, "_keep", dropping)


def a_continuation_that_skips_a_row():
    """A client that reads the history in pages misses a row between two of them."""
    behind = Span.behind

    def skipping(self, skip, read):
        rest, again = behind(self, skip, read)
        return rest, again + 1

    return mock.patch.object(Span, "behind", skipping)


def settings_that_are_not_restored():
    """An operator's forgetting factor and Freeze are forgotten in a restart."""
    load = StateFile.load
    plain = {"lam": None, "frozen": False}
    return mock.patch.object(
        StateFile, "load", lambda self, *_: [replace(one, **plain) for one in load(self)]
    )


def a_reset_that_keeps_the_map():
    """Reset forgets the residuals alone."""
    reset = EstimatorCommands.reset

    def half(self, valve, estimator):
        before = self._valves.lane(valve, estimator)
        reset(self, valve, estimator)
        after = self._valves.lane(valve, estimator)
        self._valves.put(valve, estimator, replace(after, state=before.state))

    return mock.patch.object(EstimatorCommands, "reset", half)


def a_deleted_node_that_nothing_counts():
    """Samples without one of their signals are not counted."""
    counts = Arrivals.counts

    def without(self, valves):
        found = counts(self, valves)
        found[:, COUNTER_NAMES.index("missing")] = 0
        return found

    return mock.patch.object(Arrivals, "counts", without)


def an_axis_memory_that_is_not_restored():
    """An axis forgets in a restart what had arrived of its lines."""
    return mock.patch.object(Axis, "remember", return_value=None)


def an_axis_that_acknowledges_early():
    """Messages of an axis are acknowledged before its states are saved."""
    return _acknowledged_early(AxisStates)


def rows_matched_by_time_alone():
    """Rows of signals are matched by their times alone, though a clock has stepped back."""
    meet = edges_kernel.meet

    def by_time(times, starts, last, rows, past):
        last[0] = NEVER_MET
        return meet(times, starts, last, rows, past)

    return mock.patch.object(edges_kernel, "meet", by_time)


def an_edge_that_is_not_restored():
    """The samples of an edge that wait for its line's are forgotten in a restart."""
    return mock.patch.object(KeptStates, "_take_edge", return_value=None)


def an_axis_that_learns_on_under_another_meaning():
    """The nodes and units of an axis are not compared."""
    return mock.patch.object(AxisTerms, "as_now", lambda _self, own, _change: (own, []))


def a_meter_that_is_not_restored():
    """What waits of the valves behind a meter, and what it knows, is forgotten in a restart."""
    return mock.patch.object(KeptStates, "_take_meter", return_value=None)


def old_samples_that_still_lead():
    """Commands follow the answer however old the sample is."""
    reason = feedforward._reason
    return mock.patch.object(
        feedforward, "_reason", lambda settings, at: reason(settings, replace(at, age_s=0.0))
    )


def a_disarmed_valve_that_is_led():
    """A client's call of Disarm has no effect."""
    return mock.patch.object(ArmedValves, "disarm", return_value=None)


def a_lost_source_that_is_not_asked_again():
    """After a lost connection the supervisor does not connect again."""
    wait = supervisor._wait

    async def for_ever(stop, _pause_s, consumer, tick_s):
        await wait(stop, 1e9, consumer, tick_s)

    return mock.patch.object(supervisor, "_wait", for_ever)


def a_clock_set_back_that_ends_the_learning():
    """Samples of a source whose clock was set back for more than a minute are dropped."""
    take = Identification.take

    def dropping(self, changes):
        newest = changes.source_time.max(initial=0)
        self.latest = max(getattr(self, "latest", 0), newest)
        return take(self, changes if newest > self.latest - 60 * 10**9 else changes[:0])

    return mock.patch.object(Identification, "take", dropping)


FAULTS = (
    an_early_acknowledgement,
    a_lost_sync,
    a_missing_lock,
    a_state_file_without_lock,
    an_acknowledgement_after_a_refused_save,
    a_save_without_transaction,
    a_forgotten_counter,
    a_buffer_without_bound,
    a_memory_that_is_not_restored,
    old_results_that_stay_good,
    a_batch_dropped_at_the_end_of_a_connection,
    rows_lost_between_buffer_and_disk,
    a_continuation_that_skips_a_row,
    settings_that_are_not_restored,
    a_reset_that_keeps_the_map,
    a_deleted_node_that_nothing_counts,
    an_axis_memory_that_is_not_restored,
    an_axis_that_acknowledges_early,
    rows_matched_by_time_alone,
    an_edge_that_is_not_restored,
    an_axis_that_learns_on_under_another_meaning,
    a_meter_that_is_not_restored,
    old_samples_that_still_lead,
    a_disarmed_valve_that_is_led,
    a_lost_source_that_is_not_asked_again,
    a_clock_set_back_that_ends_the_learning,
    *RELOAD_FAULTS,
)
