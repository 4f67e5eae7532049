"""Ports of the pipeline to the outside; adapters implement them, ``app`` connects them.

An adapter neither retries nor logs an error that it raises. It raises one of the typed errors of
:mod:`valvemap.errors`; the supervisor retries.
"""

from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from valvemap.model.inversion import Inversion
from valvemap.model.recursive_least_squares import Change
from valvemap.model.samples import Codes, Floats, Times
from valvemap.model.survey import Survey
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.dynamics_results import DynamicsResults
from valvemap.pipeline.nameplate import BLANK, Nameplate
from valvemap.pipeline.recommendation import Recommendation
from valvemap.vocabulary.commands import NAMED, Subject
from valvemap.vocabulary.findings import Finding
from valvemap.vocabulary.quantities import ESTIMATOR_QUANTITIES
from valvemap.vocabulary.statuses import Adaptation, FeedForwardStatus, Quality, Status


@dataclass(frozen=True)
class SourceCounters:
    """Counters of the source adapter since its creation, over all connections."""

    notifications: int = 0
    publish_responses: int = 0
    missing_messages: int = 0
    overflows: int = 0
    undecodable: int = 0
    from_history: int = 0


class Upstream(Protocol):
    """Interface of one source, or of several as one, without the connection."""

    async def write_required_U(self, valve: int, U: float) -> None:
        """Write the feed-forward voltage (%) of one valve to its node at the source.

        Raises
        ------
        SourceLost, SourceRejected
        """

    async def write_heartbeat(self, valve: int, count: int) -> None:
        """Write the heartbeat (UInt32) of one valve to its node at the source.

        Raises
        ------
        SourceLost, SourceRejected
        """

    @property
    def mark(self) -> Any:  # noqa: ANN401 - the source's private type
        """Mark of the last changes returned; None: none yet."""

    def hold_back(self) -> None:
        """From now on, keep returned changes unacknowledged until `commit`."""

    def commit(self, mark: Any) -> None:  # noqa: ANN401
        """Acknowledge changes up to ``mark``: they are safe, and the source may drop them."""

    def position(self, mark: Any) -> bytes:  # noqa: ANN401
        """Return the position of ``mark``, as accepted by `resume_at` after a restart."""

    def resume_at(self, position: bytes) -> bool:
        """Resume from a saved position, if the source still can; call before `connect`.

        Returns False if it is not a position of this source; it is then ignored.
        """

    @property
    def counters(self) -> SourceCounters:
        """Counters since the creation of the adapter."""

    @property
    def clock_offset_s(self) -> float | Floats:
        """Offset of the source's clock from ours, s, positive if ahead; 0 if unknown.

        With several sources, an array by valve.
        """

    @property
    def remarks(self) -> Mapping[int, tuple[str, ...]]:
        """By number of the valve, sentences on its nodes that are not as configured."""


class AllSources(Upstream, Protocol):
    """All sources of a service."""

    @property
    def states(self) -> tuple[str, ...]:
        """One line for each source: its connection, and its losses."""


class Source(Upstream, Protocol):
    """A source of data changes.

    Order of calls: ``connect``, then ``receive`` and ``write`` in any order, then ``close``;
    after ``close`` or a :class:`~valvemap.errors.SourceLost`, ``connect`` may be called again.
    Cancelling ``receive`` loses nothing: the next call returns the changes that have arrived.
    """

    async def connect(self) -> None:
        """Connect, check every node, subscribe.

        Raises
        ------
        SourceLost
            if the server cannot be reached: retry.
        SourceRejected
            if it refuses certificate, user or node: names the node and the permitted values.
        """

    async def receive(self) -> DataChanges:
        """Wait for data changes and return all that have arrived, in order.

        Raises
        ------
        SourceLost
            if the connection was cut, or fell silent for longer than its keep-alives allow.
        """

    async def drop(self) -> None:
        """Abandon a lost connection; the source's queue for this client remains for `connect`."""

    @property
    def is_held(self) -> bool:
        """Whether the source may still queue changes for this client."""

    async def close(self) -> None:
        """Disconnect for good; may be called twice, and after a loss."""

    @property
    def started(self) -> int:
        """Start time of the source, UTC ns, read at `connect`; 0 if unknown."""


@dataclass(frozen=True)
class EstimatorDescription:
    """The properties of an estimator that a results server publishes."""

    name: str
    description: str
    parameter_names: tuple[str, ...]
    has_forgetting_factor: bool
    finds_changes: bool = False
    chooses_structure: bool = False
    finds_lags: bool = False
    has_named_parameters: bool = False  # few parameters, each with a physical meaning


@dataclass(frozen=True)
class ValveDescription:
    """The properties of a valve that a results server publishes; ranges are (low, high)."""

    name: str
    estimators: tuple[EstimatorDescription, ...]
    Q_range: tuple[float, float] = (0.0, 200.0)
    dp_range: tuple[float, float] = (0.0, 200.0)
    map_Q: tuple[float, ...] = ()
    map_dp: tuple[float, ...] = ()
    counters: tuple[str, ...] = ()
    nameplate: Nameplate = BLANK
    U_range: tuple[float, float] = (0.0, 100.0)
    is_line: bool = False
    is_driven: bool = False


@dataclass(frozen=True)
class EstimatorResult:
    """Result of one estimator after one sample.

    ``t`` is the source time (UTC ns) of the sample. ``quality`` becomes the OPC UA severity:
    UNCERTAIN while the parameters are not determined or excitation is poor, BAD when the sensors
    are lost. ``survey`` is computed with the inverse map; None before the first. ``change`` is the
    last detected change of the valve, ``structure`` the chosen model structure. ``lags`` are the
    lags of U's effect and of the flow meter, s. ``systematic_std`` is the flow's standard deviation
    due to sensor errors at the newest sample, l/min; NaN if they are not configured.
    ``adaptation`` is the estimator's diagnosis of its residuals.
    """

    t: int
    quality: Quality
    theta: Floats
    std: Floats
    predicted: float
    residual: float
    residual_rmse: float
    sample_count: int
    status: Status
    noise_std: float = np.nan
    survey: Survey | None = None
    change: Change | None = None
    structure: str | None = None
    lags: tuple[float, float] | None = None
    adaptation: Adaptation = Adaptation.UNDECIDED
    systematic_std: float = np.nan


@dataclass(frozen=True)
class InverseResult:
    """Answer to the standing demand (FlowDemand, PressureDrop), and the map as a table.

    ``required_U`` is between ``lower`` and ``upper`` with 95 % probability, all in %. ``map_U`` has
    shape (len(map_Q), len(map_dp)), %; NaN where the valve cannot deliver. ``armed``
    and ``feed_forward`` give the state of feed-forward: whether the answer is written to the valve.
    """

    t: int
    quality: Quality
    required_U: float
    status: int
    map_U: Floats
    armed: bool = False
    feed_forward: FeedForwardStatus = FeedForwardStatus.NOT_CONFIGURED
    lower: float = np.nan
    upper: float = np.nan


@dataclass(frozen=True)
class ValveResult:
    """All results of one valve."""

    valve: int
    estimators: Mapping[str, EstimatorResult]
    inverse: InverseResult
    counters: Mapping[str, int]


@dataclass(frozen=True)
class EstimatorResults:
    """One estimator on M valves: the fields of :class:`EstimatorResult`, all of length M.

    ``theta`` and ``std`` have shape (M, n). ``old`` masks the valves whose newest sample is old;
    None: no valve.
    """

    t: Times
    quality: Codes
    theta: Floats
    std: Floats
    predicted: Floats
    residual: Floats
    residual_rmse: Floats
    sample_count: Times
    status: Codes
    noise_std: Floats
    survey: Sequence[Survey | None]
    change: Sequence[Change | None]
    structure: Sequence[str | None]
    lags: Sequence[tuple[float, float] | None]
    adaptation: Codes
    systematic_std: Floats
    old: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class InverseResults:
    """The inverse maps of M valves: the fields of :class:`InverseResult`, all of length M."""

    t: Times
    quality: Codes
    required_U: Floats
    status: Codes
    map_U: Sequence[Floats]
    armed: NDArray[np.bool_]
    feed_forward: Codes
    lower: Floats
    upper: Floats


@dataclass(frozen=True)
class LineResults:
    """What M lines of valves with ports have beside other valves; all arrays (M,).

    ``leakage`` and ``leakage_std`` are in l/min/bar, NaN while unknown. ``edge`` (`LineEdge`)
    passes the demanded flow.
    """

    leakage: Floats
    leakage_std: Floats
    edge: Codes


@dataclass(frozen=True)
class SignalResults:
    """The newest sample of each of M valves as received, in the service's units.

    ``values`` has a column for each of ``vocabulary.signals.PUBLISHED``; NaN if absent. ``quality``
    (M,) is the source's, BAD if the sensors are lost; ``t`` (M,) is 0 before the first sample.
    """

    t: Times
    quality: Codes
    values: Floats


@dataclass(frozen=True)
class AlarmReport:
    """State of one alarm.

    ``since`` is the time of the last activation, ``at`` that of the last activation, deactivation
    or acknowledgement, both UTC ns, 0: never. ``count`` is the number of activations. ``text``
    gives the measured value, its beginning and possible causes. ``confirmed`` is False between
    acknowledgement and confirmation; ``limit`` is the alarm's limit. ``comment``, ``commented_by``
    and ``commented`` are the last comment, its author and its time (UTC ns; 0: none).
    """

    name: str
    active: bool
    acked: bool
    severity: int
    since: int
    at: int
    count: int
    text: str
    confirmed: bool = True
    limit: float = 0.0
    comment: str = ""
    commented_by: str = ""
    commented: int = 0


@dataclass(frozen=True)
class Remark:
    """An operator's comment on an alarm: text, author, time (UTC ns)."""

    text: str
    by: str
    t: int


@dataclass(frozen=True)
class Command:
    """An operator's command on a valve, or (None) the service.

    ``part`` names the estimator or alarm; ``values`` are the command's numbers; an alarm's command
    has a ``remark``.

    Examples
    --------
    >>> Command.of("set_forgetting_factor", "V1", "RLS", 0.99)
    Command(action='set_forgetting_factor', valve='V1', part='RLS', values=(0.99,), remark=None)
    """

    action: str
    valve: str | None
    part: str = ""
    values: tuple[float, ...] = ()
    remark: Remark | None = None

    @classmethod
    def of(cls, action: str, valve: str | None, *given: Any) -> "Command":  # noqa: ANN401
        """Return a command of `ACTIONS` with its arguments in order."""
        match NAMED[action].on:
            case Subject.ESTIMATOR:
                return cls(action, valve, given[0], tuple(given[1:]))
            case Subject.ALARM:
                return cls(action, valve, given[0], remark=given[1])
            case _:
                return cls(action, valve, values=tuple(given))

    @property
    def arguments(self) -> tuple[Any, ...]:
        """All of it but the action, as given to `of`."""
        match NAMED[self.action].on:
            case Subject.ESTIMATOR:
                return (self.valve, self.part, *self.values)
            case Subject.ALARM:
                return (self.valve, self.part, self.remark)
            case _:
                return (self.valve, *self.values)


@dataclass(frozen=True)
class AlarmChange:
    """One change of an alarm, for the history.

    ``owner`` is a valve's name or the service's, ``t`` the time of the change (UTC ns), ``report``
    the state after it.
    """

    owner: str
    t: int
    report: AlarmReport


@dataclass(frozen=True)
class AlarmResults:
    """The alarms of M valves.

    ``version`` (M,) increases with each change of any alarm of a valve; ``reports(m)`` returns the
    state of all alarms of the m-th valve, and must be called before the next update.
    """

    version: Times
    reports: Callable[[int], Sequence[AlarmReport]]


class Version(Protocol):
    """An approved map: its name, source time of its newest sample (UTC ns), its hash."""

    @property
    def version(self) -> str:
        """Its name."""

    @property
    def t(self) -> int:
        """UTC ns."""

    @property
    def digest(self) -> str:
        """SHA-256, hexadecimal."""


class Compared(Protocol):
    """A map minus the approved one, l/min."""

    @property
    def mean(self) -> float:
        """Mean difference over all points."""

    @property
    def largest(self) -> float:
        """Largest difference by magnitude, signed."""

    @property
    def U(self) -> float:
        """U of the largest difference, %."""

    @property
    def dp(self) -> float:
        """Pressure drop of the largest difference, bar."""

    @property
    def points(self) -> int:
        """Number of compared points."""


@dataclass(frozen=True)
class Results:
    """All published results of M valves with the same plan.

    ``valves`` (M,) are their numbers; ``counters`` have a column for each of ``counter_names``.
    For each valve, ``waiting`` gives the reasons why its samples are not used, ``timing`` how its
    signals are stamped, ``baselines`` its approved map, ``recommended`` the estimator to use,
    ``findings`` the causes that explain its samples, ``dynamics`` those of spool and meter,
    ``alarms`` the state of its alarms.
    """

    valves: Times
    estimators: Mapping[str, EstimatorResults]
    inverse: InverseResults
    counters: Times
    counter_names: tuple[str, ...]
    signals: SignalResults | None = None
    waiting: Sequence[tuple[str, ...]] = ()
    timing: Sequence[tuple[str, ...]] = ()
    baselines: Sequence[Version | None] = ()
    recommended: Sequence[Recommendation] = ()
    findings: Sequence[tuple[Finding, ...]] = ()
    dynamics: Sequence[DynamicsResults] = ()
    alarms: AlarmResults | None = None
    lines: LineResults | None = None

    def one(self, m: int) -> ValveResult:
        """Return the results of the m-th valve."""
        return ValveResult(
            valve=int(self.valves[m]),
            estimators={
                name: EstimatorResult(
                    t=int(found.t[m]),
                    quality=Quality(int(found.quality[m])),
                    theta=found.theta[m],
                    std=found.std[m],
                    survey=found.survey[m],
                    change=found.change[m],
                    structure=found.structure[m],
                    lags=found.lags[m],
                    **{
                        quantity.field: quantity.one(getattr(found, quantity.field)[m])
                        for quantity in ESTIMATOR_QUANTITIES
                    },
                )
                for name, found in self.estimators.items()
            },
            inverse=InverseResult(
                t=int(self.inverse.t[m]),
                quality=Quality(int(self.inverse.quality[m])),
                required_U=float(self.inverse.required_U[m]),
                status=int(self.inverse.status[m]),
                map_U=self.inverse.map_U[m],
                armed=bool(self.inverse.armed[m]),
                feed_forward=FeedForwardStatus(int(self.inverse.feed_forward[m])),
                lower=float(self.inverse.lower[m]),
                upper=float(self.inverse.upper[m]),
            ),
            counters=dict(zip(self.counter_names, self.counters[m].tolist(), strict=True)),
        )


@dataclass(frozen=True)
class PastCounters:
    """Rows of the history that were lost, failed saves, and bytes of its file."""

    lost: int = 0
    failures: int = 0
    bytes: int = 0


@dataclass(frozen=True)
class StartState:
    """How far the service's start is: a sentence, and the compiled share of its kernels, %."""

    text: str
    compiled_percent: float


COMPLETE = StartState("complete: all estimators run", 100.0)


@dataclass(frozen=True)
class Health:
    """Freshness of the data and state of the checkpoints; arrays over all valves.

    Attributes
    ----------
    age_s : float64
        Age of the newest sample by the source's clock, s; NaN before the first.
    waiting : int64
        Samples that wait for signals or for earlier samples.
    source, source_states
        Counters summed over all sources; one line for each source.
    checkpoint_age_s : float
        Time since the last save of states, s; NaN before the first.
    checkpoint_failures, checkpoint_bytes, checkpoints_refused : int
        Saves that failed, size of the store, and checkpoints rejected at the start.
    alarms
        State of the service's alarms.
    history
        Counters of the history.
    start
        Progress of the service's start.
    """

    age_s: Floats
    waiting: Times
    source: SourceCounters = SourceCounters()
    source_states: tuple[str, ...] = ()
    checkpoint_age_s: float = np.nan
    checkpoint_failures: int = 0
    checkpoint_bytes: int = 0
    checkpoints_refused: int = 0
    alarms: Sequence[AlarmReport] = ()
    history: PastCounters = PastCounters()
    start: StartState = COMPLETE


class ResultSink(Protocol):
    """Receiver of results; ``publish`` never waits for a reader."""

    async def publish(self, results: Results) -> None:
        """Publish results; a later call for the same valve replaces the earlier one."""

    async def doubt(self, valves: Times) -> None:
        """Set the published results of these valves to Uncertain or worse: they are old."""

    async def show_health(self, health: Health) -> None:
        """Publish the service's health."""


T = TypeVar("T")
Answer: TypeAlias = T | Awaitable[T]


class Operator(Protocol):
    """Commands and queries of a results server's clients; they return at once or are awaitable.

    ``valve`` and ``estimator`` are names that the server was built with. A command that is refused
    raises :class:`~valvemap.errors.CommandRejected` with a sentence.
    """

    def do(self, command: Command) -> Answer[None]:
        """Carry out one of :mod:`~valvemap.vocabulary.commands`."""

    def predict(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> Answer[tuple[float, float, Status]]:
        """Q (l/min), its standard deviation and the estimator's status."""

    def predict_measurement(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> Answer[tuple[float, float, float, Status]]:
        """Q, the 95 % interval of a new measurement (l/min), and the estimator's status."""

    def invert(self, valve: str, Q: float, dp: float, T: float) -> Answer[Inversion]:
        """U for a demanded flow at a pressure drop; arrays of shape (1,)."""

    def compare(self, valve: str, estimator: str) -> Answer[Compared]:
        """Return the difference of an estimator's map from the baseline."""

    def predict_approved(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> Answer[tuple[float, float, Status]]:
        """Q (l/min), its standard deviation and status, by the approved map."""

    def baseline(self, valve: int) -> Version | None:
        """Return the baseline of a valve, by its number."""

    def alarmed(self) -> Iterable[str]:
        """Return the valves that have ever had an active alarm."""

    def alarms(self, valve: str | None) -> Sequence[AlarmReport]:
        """Return the state of all alarms of a valve or (None) of the service."""


class KeptElsewhere(Protocol):
    """States that are saved beside the valves', in a file of their own."""

    failures: int
    """Saves that failed."""

    def age_s(self, now: float) -> float:
        """Time since the last save, monotonic s; ∞: the file was lost."""


class CheckpointStore(Protocol):
    """Stores the newest state of every estimator over restarts."""

    def save(self, checkpoints: Sequence["Checkpoint"]) -> None:
        """Save all of them or none.

        Raises
        ------
        StorageError
            naming the file (disk full, read-only, locked).
        """

    def load(self) -> Sequence["Checkpoint"]:
        """Return the newest checkpoint of each (valve, estimator)."""

    def put_aside(
        self,
        aside: Sequence[tuple["Checkpoint", str]],
        moved: Mapping[tuple[str, str], tuple[str, str]],
    ) -> None:
        """Keep checkpoints that are not restored, each with its reason, and rename others.

        ``moved`` maps (valve, estimator) to its new name.

        Raises
        ------
        StorageError
            naming the file.
        """

    @property
    def size(self) -> int:
        """Size in bytes."""

    @property
    def damaged(self) -> Sequence[str]:
        """``<Valve>.<Estimator>`` whose newest state was damaged at `load`."""


@dataclass(frozen=True)
class Checkpoint:
    """One estimator's state as bytes, and the operator's settings.

    ``meaning`` is that of the valve's signals, see :class:`valvemap.pipeline.meaning.Meaning`;
    empty: unknown.
    """

    valve: str
    estimator: str
    key: str
    t: int
    state: bytes
    lam: float | None
    frozen: bool
    meaning: str = ""


@dataclass(frozen=True)
class Piece:
    """Successive rows of one series, for the history.

    Times ``t`` (n,) in UTC ns, OPC UA status ``codes`` (n,), and columns (n,) by name.
    """

    series: str
    t: Times
    codes: NDArray[np.uint32]
    columns: Mapping[str, Floats]


@dataclass(frozen=True)
class Past:
    """History of one column of a series: times (n,) in UTC ns, values (n,), status codes (n,)."""

    t: Times
    values: Floats
    codes: NDArray[np.uint32]

    def __getitem__(self, rows: slice) -> "Past":
        return Past(self.t[rows], self.values[rows], self.codes[rows])


@dataclass(frozen=True)
class PastCells:
    """One column of a series, summarised in cells of equal width; all arrays of shape (n,).

    Attributes
    ----------
    t
        Start of each cell, UTC ns, a multiple of the width; cells without rows are left out.
    rows, good, uncertain
        Number of rows, and of those with a Good and an Uncertain value; the others are Bad.
    low, high, total
        Minimum, maximum and sum of the Good values; ∞, −∞, 0 without one.
    marks
        Bits: 1, 2: minimum, maximum occur more than once; 4, 8: they are the first Good value, at
        the cell's start.
    extent
        First and last time of all rows of the series, UTC ns.
    """

    t: Times
    rows: Times
    good: Times
    uncertain: Times
    low: Floats
    high: Floats
    total: Floats
    marks: NDArray[np.uint8]
    extent: tuple[int, int]


class PastStore(Protocol):
    """Stores and returns the history of signals and results; from any thread, one at a time.

    Attributes
    ----------
    widths
        Widths of the cells of `cells`, ascending, ns.
    """

    widths: Sequence[int]

    @property
    def lost(self) -> int:
        """Rows lost by damage to the file, or because others of their time are stored."""

    def save(self, pieces: Iterable[Piece]) -> int:
        """Save all pieces or none; return the number of values skipped as stored already.

        Raises
        ------
        StorageError
            naming the file.
        """

    def forget(self) -> int:
        """Drop blocks that are too old or over the size limit; return their number."""

    def read(
        self,
        series: str,
        column: str,
        low: int,
        high: int,
        *,
        backwards: bool = False,
        skip: int = 0,
        most: int,
    ) -> Past:
        """Return rows from ``low`` to ``high`` (UTC ns, inclusive), without the first ``skip``."""

    def cells(self, series: str, column: str, low: int, high: int, width: int) -> PastCells | None:
        """Return the cells of a width (ns) that begin from ``low`` to before ``high``.

        None if there are none of that width, or while a file is repaired.
        """

    def note(self, changes: Sequence[AlarmChange]) -> None:
        """Save changes of alarms; a change that is stored already is skipped.

        Raises
        ------
        StorageError
            naming the file.
        """

    def changes(
        self,
        owner: str | None,
        low: int,
        high: int,
        *,
        backwards: bool = False,
        skip: int = 0,
        most: int,
    ) -> Sequence[AlarmChange]:
        """Return changes of an owner's alarms (None: all owners), see :meth:`read`."""

    def take_notes(self) -> Sequence[str]:
        """Return the messages about damage since the last call."""

    @property
    def size(self) -> int:
        """Size in bytes."""
