"""Feeds samples to the estimators: stores the newest, and rejects implausible ones."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Codes, Samples, Segments, Times, Trace
from valvemap.pipeline.alignment import COUNTER_NAMES
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.edges import LEAK, Splitter, gathered
from valvemap.pipeline.fleet import Fleet
from valvemap.pipeline.lane_failures import Rows, Step
from valvemap.pipeline.meters import Meters
from valvemap.pipeline.plausibility import Finding, Kind, Plausibility, refuse
from valvemap.pipeline.results import SignalResults
from valvemap.pipeline.stretches import turns
from valvemap.vocabulary.signals import PUBLISHED
from valvemap.vocabulary.statuses import Quality

_CONTRADICTED = (
    "U, p1 - p2 and Q contradicted each other: once that is mended, a restart has the valve learnt"
)
VALVES_AT_ONCE = 256  # valves per update: 20 MB of saved states, kept until all are updated
_LOST = [COUNTER_NAMES.index(name) for name in ("missing", "gaps", "lost_by_time")]
_ALIGNED = COUNTER_NAMES.index("aligned")


class SampleIntake:
    """Updates all valves with the samples that arrive.

    Parameters
    ----------
    valves
        The valves.
    arrivals
        Converts data changes into samples.

    Attributes
    ----------
    newest : SignalResults
        The newest sample of each of the V valves, as received.
    refuted : bool
        Mask (V,) of the valves with inconsistent signals: rejected until a restart.
    plausibility : Plausibility
        Evidence for and against plausible signals.
    splitter : Splitter
        Splits the samples of valves with ports into those of edges.
    meters : Meters
        Divides the flow of meters among the valves behind them.
    """

    def __init__(self, valves: AllValves, arrivals: Arrivals) -> None:
        self._valves = valves
        self._arrivals = arrivals
        V = len(valves.plans)
        self.newest = SignalResults(
            t=np.zeros(V, np.int64),
            quality=np.zeros(V, np.uint8),
            values=np.full((V, len(PUBLISHED)), np.nan),
        )
        self.plausibility = Plausibility(V)
        self.refuted = np.zeros(V, np.bool_)
        self._insists = np.array([plan.insist for plan in valves.plans], np.bool_)
        self.splitter = Splitter(
            [plan.part for plan in valves.plans], [plan.name for plan in valves.plans]
        )
        self.meters = Meters(
            [plan.meter for plan in valves.plans], [plan.U_range for plan in valves.plans]
        )

    def take(self, changes: DataChanges) -> ByValve:
        """Align data changes and estimate; return the samples they completed, by valve."""
        self._start_again()
        return self._learn_arrived(self._arrivals.take(changes))

    def wait_no_longer(self, valves: Times) -> ByValve:
        """Flush the reorder buffer of these valves; return the samples as `take` does."""
        return self._learn_arrived(self._arrivals.wait_no_longer(valves))

    def begin_source_anew(self, valves: Times, started: int) -> ByValve:
        """Reset the alignment of these valves: the running numbers of their source restart."""
        return self._learn_arrived(self._arrivals.begin_source_anew(valves, started))

    def learn(self, arrived: ByValve) -> ByValve:
        """Estimate from aligned samples; return them, with implausible samples marked BAD.

        Of valves with ports, the lines come first: their leakage is not the edges' flow.
        """
        if not (self.splitter or self.meters):
            if not len(arrived.samples):
                return arrived
            self._note_newest(arrived)
            arrived = self._without_implausible(arrived)
            self._estimate(arrived)
            return arrived
        lines, others = self.splitter.divide(arrived)
        self._note_newest(lines)
        self._estimate(lines)
        before = self.meters.dropped.copy()
        others, of_meters = self.meters.share(others, self._stop_alignment)
        unmet = (self.meters.dropped > before).nonzero()[0]
        for fleet, own in self._valves.by_fleet(unmet):
            self._note_losses(fleet, unmet[own])
        others, used = self.splitter.split(others, self._stop_alignment)
        for valve, first, last in zip(*(x.tolist() for x in others.segments), strict=True):
            if valve in of_meters:
                used[first:last] = of_meters[valve]
        self._note_newest(others)
        rows, learnt = used.nonzero()[0], others.segments.among(used)
        some = ByValve(others.samples[rows], learnt.of(learnt.stops > learnt.starts))
        some = self._without_implausible(some)
        before_row = np.concatenate([np.zeros(1, np.int64), np.cumsum(used)])
        for turn in turns(others.segments, used):
            self._pass(others.samples, turn.passed)
            valves, starts, stops = turn.learnt
            now = Segments(valves, before_row[starts], before_row[stops])
            self._estimate(replace(some, segments=now.of(now.stops > now.starts)))
        others.samples.quality[rows] = some.samples.quality
        return gathered({**lines, **others})

    def _pass(self, samples: Samples, passed: Segments) -> None:
        """Note good samples from which nothing is learnt: no sensor is lost then."""
        good = passed.among(samples.quality != Quality.BAD)
        own = good.stops > good.starts
        t = samples.t[samples.quality != Quality.BAD]
        valves, starts, stops = good.of(own)
        for fleet, chosen in self._valves.by_fleet(valves):
            places = self._valves.places[valves[chosen]]
            first, last = t[starts[chosen]], t[stops[chosen] - 1]

            def watch(
                rows: Rows,
                fleet: Fleet = fleet,
                places: Times = places,
                first: Times = first,
                last: Times = last,
            ) -> None:
                fleet.alarms.note_passed(places[rows], first[rows], last[rows])

            fleet.watch(places, watch)

    def _estimate(self, arrived: ByValve) -> None:
        """Update the fleets; the leakage that lines predict is handed to their edges."""
        valves, starts, stops = arrived.segments
        for fleet, every in self._valves.by_fleet(valves):
            for first_of in range(0, len(every), VALVES_AT_ONCE):
                own = every[first_of : first_of + VALVES_AT_ONCE]
                rows, first, last = _rows(starts[own], stops[own])
                segments = Segments(self._valves.places[valves[own]], first, last)
                samples = arrived.samples[rows]
                _, traces = fleet.take(samples, segments)
                self._note_losses(fleet, valves[own])
                if fleet.plan.part is not None and fleet.plan.part.edge is None:
                    for k, start, stop in zip(own, first, last, strict=True):
                        line = int(valves[k])
                        leakage = traces[LEAK].predicted[start:stop]
                        self.splitter.note_leakage(line, samples.t[start:stop], leakage)

    def _stop_alignment(self, valve: int, error: Exception) -> None:
        self._valves.stop(valve, Step.ALIGNMENT, None, error)

    def take_samples(self, valve: int, samples: Samples) -> tuple[Samples, Mapping[str, Trace]]:
        """Estimate from one valve's samples; return them as gated, and each estimator's trace."""
        if len(samples) == 0:
            return samples, {}
        fleet, m = self._valves.at(valve)
        return fleet.take(samples, Segments.one(len(samples))._replace(members=np.array([m])))

    @property
    def implausible(self) -> NDArray[np.bool_]:
        """Mask (V,) of the valves whose samples are rejected as implausible."""
        return self.refuted | (self.plausibility.refused() & ~self._insists)

    def findings(self, valve: int) -> list[Finding]:
        """Return the reasons why a valve's signals are implausible."""
        found = self.plausibility.findings(valve)
        if self.refuted[valve] and all(finding.kind is Kind.HINT for finding in found):
            return [Finding(Kind.REFUSED, _CONTRADICTED), *found]
        return found

    def judge(self, valve: int) -> None:
        """Reject a valve's samples from now on if its signals are inconsistent."""
        self.refuted[valve] |= not self._insists[valve] and self.plausibility.is_refuted(valve)

    def signals(self, valves: Times, at_best: Codes) -> SignalResults:
        """Newest sample of the given valves (M,), of a quality no better than ``at_best`` (M,)."""
        newest = self.newest
        quality = np.maximum(newest.quality[valves], at_best)
        return SignalResults(newest.t[valves], quality, newest.values[valves])

    def _start_again(self) -> None:
        """Align valves again whose alignment had raised, once an operator has reset them."""
        for valve in self._arrivals.failed.nonzero()[0].tolist():
            fleet, m = self._valves.at(valve)
            if not fleet.lanes.stopped()[m]:
                self._arrivals.start_again(valve)

    def _learn_arrived(self, arrived: ByValve) -> ByValve:
        """Stop the valves whose alignment raised, and estimate from the others' samples."""
        for valve, error in self._arrivals.buffers.new_failures():
            self._valves.stop(valve, Step.ALIGNMENT, None, error)
        return self.learn(arrived)

    def _note_newest(self, arrived: ByValve) -> None:
        valves, _, stops = arrived.segments
        last, newest = arrived.samples[stops - 1], self.newest
        newest.t[valves], newest.quality[valves] = last.t, last.quality
        newest.values[valves] = np.array([getattr(last, name) for name in PUBLISHED]).T

    def _without_implausible(self, arrived: ByValve) -> ByValve:
        """Return the samples, with implausible ones marked BAD."""
        refused = self.plausibility.count(arrived.samples, arrived.segments)
        valves, starts, stops = arrived.segments
        for k in self._insists[valves].nonzero()[0]:
            refused[starts[k] : stops[k]] = False
        for k in self.refuted[valves].nonzero()[0]:
            refused[starts[k] : stops[k]] = True
        return replace(arrived, samples=refuse(arrived.samples, refused))

    def _note_losses(self, fleet: Fleet, valves: Times) -> None:
        counts, places = self._arrivals.counts(valves), self._valves.places[valves]
        lost, aligned = counts[:, _LOST].sum(axis=1), counts[:, _ALIGNED]
        lost = lost + self.meters.dropped[valves]
        holds = self._arrivals.timing.holds[valves]

        def watch(rows: Rows) -> None:
            fleet.alarms.note_losses(places[rows], lost[rows], aligned[rows])
            fleet.alarms.be_patient(places[rows], holds[rows])

        fleet.watch(places, watch)


def _rows(starts: Times, stops: Times) -> tuple[slice | NDArray[np.int64], Times, Times]:
    """Return the rows of the segments, and the segments' bounds within those rows."""
    if (starts[1:] == stops[:-1]).all():
        return slice(starts[0], stops[-1]), starts - starts[0], stops - starts[0]
    rows = np.concatenate([np.arange(*pair) for pair in zip(starts, stops, strict=True)])
    last = np.cumsum(stops - starts)
    return rows, last - (stops - starts), last
