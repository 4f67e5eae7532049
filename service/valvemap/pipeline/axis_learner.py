"""What an axis learns while it moves: its map, its play and spool, and the watch for changes. Pure.

A search over the newest minutes finds play and spool, and takes seconds: the caller runs it beside
everything else, as it does the solution of the sums. Between two searches the sums continue sample
by sample.
"""

from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from valvemap.model.axis import AxisRegression, AxisSamples, AxisState
from valvemap.model.axis_basis import SIZE
from valvemap.model.axis_fit import with_map
from valvemap.model.axis_search import AxisResult, identify
from valvemap.model.kernels.flow_rules import BETWEEN_JUMPS
from valvemap.model.samples import Floats
from valvemap.pipeline.axis_jobs import Job, Known, Outcome, Weighed, solved, weighed
from valvemap.pipeline.axis_past import Past
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.axis_searches import Searches
from valvemap.pipeline.axis_watch import AxisWatch
from valvemap.pipeline.axis_window import AxisWindow
from valvemap.pipeline.kept_axes import LEARNT, SEARCHES, WATCH, Learnt, pack, unpack
from valvemap.pipeline.kept_watches import pack_watch, unpack_watch

WINDOW_S: Final = 200.0  # s of movement; length of a search: more does not move play and spool
MOST_SAMPLES: Final = 250_000  # of the window, if samples come very quickly
CHANGES_PER_S: Final = 1.0 / BETWEEN_JUMPS  # 1/s; sudden changes that are expected of an edge
REFIT_S: Final = 5.0  # s of movement between two fits of the sums
SAME_PLAY_PERCENT, SAME_LAG_S = 0.25, 0.003  # up to these differences the sums continue


class AxisLearner:
    """`take` the samples of one axis, do the `job` that is due, and `accept` what it has found.

    Parameters
    ----------
    plan
        Geometry and memory of the axis.

    Attributes
    ----------
    regression, state : AxisRegression, AxisState or None
        With its play and spool, and its sums; None: there are none yet.
    known : Known or None
        The newest solution of the sums.
    searches, window : Searches, AxisWindow
        The searches so far, and the samples of the next one.
    refused : AxisResult or None
        The last search, if it was refused.
    watch : AxisWatch or None
        What findings are made by.
    """

    def __init__(self, plan: AxisPlan) -> None:
        self._plan = plan
        self.window = AxisWindow(WINDOW_S, MOST_SAMPLES)
        self._since: list[AxisSamples] | None = None  # while a search runs
        self._works = False
        self.searches, self._to_refit_s = Searches(), REFIT_S
        self.refused: AxisResult | None = None
        self.state: AxisState | None = None
        self._past = Past()
        self.regression = AxisRegression(plan.geometry, has_place=not plan.has_speed)
        self._of_shape: Floats = np.zeros((SIZE, SIZE))
        self.known: Known | None = None
        self.watch: AxisWatch | None = None

    def take(self, samples: AxisSamples, passed_s: float) -> None:
        """Learn from samples with movement, which took ``passed_s``."""
        self.window.append(passed_s, samples)
        self.searches = self.searches.after(passed_s)
        if self._since is not None:
            self._since.append(samples)
        if self.state is not None:
            before = self.state.has_changed
            self.state, _ = self.regression.update(self.state, samples)
            self._to_refit_s -= passed_s
            self._drop_rows_of_change(passed_s)
            if self.state.has_changed and not before:
                self._search_anew()
        if self.watch is not None:
            self.watch = self.watch.after(samples)

    def job(self) -> Job | None:
        """Return the work that is due, for another thread; None: there is none, or one is done.

        It changes nothing here: `accept` its outcome, or `abandon` it.
        """
        if self._works:
            return None
        if self.searches.is_due and self.window:
            self._works, self._since = True, []
            plan, window = self._plan, self.window.whole()
            return partial(identify, window, plan.geometry, memory_s=plan.memory_s)
        if self._to_refit_s <= 0.0 and self.state is not None:
            self._works, self._to_refit_s = True, REFIT_S
            newest = self.window.whole() if self._begins_watch and self.window else None
            return partial(solved, self.regression, self.state, self._of_shape, newest)
        if self.watch is not None and self.watch.closed:
            self._works = True
            return partial(weighed, self.watch)
        return None

    def accept(self, outcome: Outcome) -> None:
        """Apply the outcome of a job; a refusal changes no map that there is."""
        self._works = False
        if isinstance(outcome, Known):
            self.known = outcome
            if self.state is not None:
                self.state = with_map(self.state, outcome.sums)
            self._begin_watch(outcome)
            return
        if isinstance(outcome, Weighed):
            watch, before = self.watch, outcome.before
            if watch is not None and watch.reference is before.reference:
                self.watch = watch.accepted(before, outcome.after)
            return
        since, self._since = self._since or [], None
        if outcome.status or outcome.fit is None or outcome.state is None:
            self.searches, self.refused = self.searches.failed(), outcome
            return
        self.searches, self.refused = self.searches.succeeded(), None
        if outcome.of_shape is not None:
            self._of_shape = outcome.of_shape
        if self.state is None or not _are_alike(self.regression, outcome.fit.regression):
            self.regression = replace(outcome.fit.regression, changes_per_s=CHANGES_PER_S)
            self.state, self._past = outcome.state, Past()
            for samples in since:
                self.state, _ = self.regression.update(self.state, samples)
        self._to_refit_s = 0.0

    def _begin_watch(self, known: Known) -> None:
        """Take the map as the reference of findings, once play and spool are settled."""
        if self._begins_watch and self.state is not None:
            of_shape, memory_s = self._of_shape, self._plan.memory_s
            self.watch = AxisWatch.begin(self.state, known.fit, memory_s, of_shape, known.forces)

    @property
    def _begins_watch(self) -> bool:
        return self.watch is None and self.searches.are_settled

    def set_reference(self) -> None:
        """Learn anew; the map stays until there is a new one, findings come after the searches."""
        self.window.clear()
        self.watch = self.state = self._since = None
        self._past = Past()
        self.searches = Searches()

    def _drop_rows_of_change(self, passed_s: float) -> None:
        """Continue with the sums from before a change of an edge that was just found."""
        if self.state is not None:
            past, state = self._past.without_change(self.state)
            if state is not self.state:
                self._to_refit_s = 0.0
            self._past, self.state = past.after(state, passed_s), state

    def _search_anew(self) -> None:
        """Search play and spool in the samples after a sudden change alone."""
        self.window.clear()
        self.searches = self.searches.over_new_samples()

    def abandon(self) -> None:
        """Note that a job ended without an outcome."""
        self._works, self._since, self.searches = False, None, self.searches.abandoned()

    @property
    def learnt(self) -> Learnt | None:
        """What has been learnt; None: nothing yet."""
        if self.state is None:
            return None
        return Learnt(self.regression, self.state, self._of_shape)

    def continue_from(self, learnt: Learnt) -> None:
        """Continue from this; the next `job` gives its map."""
        self.regression, self.state, self._past = learnt.regression, learnt.state, Past()
        self._of_shape, self._to_refit_s = learnt.of_shape, 0.0

    def to_bytes(self) -> dict[str, bytes]:
        """Return searches, the learnt state, and the reference of findings, if any."""
        key, found = self._plan.key, dict[str, bytes]()
        if (learnt := self.learnt) is not None:
            found[LEARNT] = pack(learnt, key)
            found[SEARCHES] = self.searches.to_bytes(key)
        if self.watch is not None:
            found[WATCH] = pack_watch(self.watch, key)
        return found

    def resume(self, name: str, packed: bytes, key: str) -> None:
        """Resume a stored state of this name, bound to ``key``; the next `job` gives its map.

        Raises
        ------
        StateMismatchError
            if it is damaged, or bound to something else.
        """
        if name == SEARCHES:
            self.searches = Searches.from_bytes(packed, key).resumed()
            return
        regression = AxisRegression(
            self._plan.geometry,
            memory_s=self._plan.memory_s,
            changes_per_s=CHANGES_PER_S,
            has_place=not self._plan.has_speed,
        )
        if name == WATCH:
            self.watch = unpack_watch(packed, key, regression)
            return
        self.continue_from(unpack(packed, key, regression))


def _are_alike(one: AxisRegression, other: AxisRegression) -> bool:
    return (
        abs(one.play_percent - other.play_percent) <= SAME_PLAY_PERCENT
        and abs(1.0 / one.spool_hz - 1.0 / other.spool_hz) <= SAME_LAG_S
        and abs(one.period_s - other.period_s) < 0.01 * one.period_s
    )
