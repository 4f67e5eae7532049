"""What streaming asks of the world outside; adapters fulfil it, ``app`` hands them in.

No adapter retries and none logs what it raises: it raises one of the typed errors of
:mod:`valvemap.errors`, and the supervisor decides.
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
from valvemap.pipeline.nameplate import BLANK, Nameplate
from valvemap.vocabulary.quantities import ESTIMATOR_QUANTITIES
from valvemap.vocabulary.statuses import Adaptation, FeedForwardStatus, Quality, Status


@dataclass(frozen=True)
class SourceCounters:
    """What the source adapter saw since it was made, over all connections."""

    notifications: int = 0
    publish_responses: int = 0
    missing_messages: int = 0
    overflows: int = 0
    undecodable: int = 0
    from_history: int = 0


class Upstream(Protocol):
    """What is asked of a source, or of several together, by who does not mind connections."""

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
    def mark(self) -> Any:  # noqa: ANN401 - the source's own
        """How far changes have been handed out; None: none were."""

    def hold_back(self) -> None:
        """Let the source keep what is handed out until `commit` says that it is safe."""

    def commit(self, mark: Any) -> None:  # noqa: ANN401
        """What was handed out up to a mark is safe: the source need not keep it any more."""

    def position(self, mark: Any) -> bytes:  # noqa: ANN401
        """What `resume_at` goes on from after a restart."""

    def resume_at(self, position: bytes) -> bool:
        """Go on from a position that was kept, if the source still can; before `connect`.

        False: it cannot be one of this source, and is forgotten.
        """

    @property
    def counters(self) -> SourceCounters:
        """What was seen so far."""

    @property
    def clock_offset_s(self) -> float | Floats:
        """By how much the source's clock is ahead of ours; 0 if it did not say.

        Where there are several sources, by valve.
        """


class AllSources(Upstream, Protocol):
    """All sources of a service."""

    @property
    def states(self) -> tuple[str, ...]:
        """A line for each source: whether it is there, and what was lost of it."""


class Source(Upstream, Protocol):
    """Where data changes come from.

    Order of calls: ``connect``, then ``receive`` and ``write`` in any order, then ``close``;
    after ``close`` or a :class:`~valvemap.errors.SourceLost`, ``connect`` may be called again.
    Cancelling ``receive`` loses nothing: what has arrived is handed out by the next call.
    """

    async def connect(self) -> None:
        """Connect, check every node, subscribe.

        Raises
        ------
        SourceLost
            if the server cannot be reached: worth another try.
        SourceRejected
            if it refuses certificate, user or node: names the node and what is allowed.
        """

    async def receive(self) -> DataChanges:
        """Wait for data changes and return all that have arrived, in order.

        Raises
        ------
        SourceLost
            if the connection was cut, or fell silent for longer than its keep-alives allow.
        """

    async def drop(self) -> None:
        """Leave a connection that is lost: what the source holds for us is there at `connect`."""

    @property
    def is_held(self) -> bool:
        """Whether the source may still hold for us what we have not heard."""

    async def close(self) -> None:
        """Disconnect for good; safe to call twice, and after a loss."""

    @property
    def started(self) -> int:
        """When the source was started, UTC ns, as it said at `connect`; 0 if it did not."""


@dataclass(frozen=True)
class EstimatorDescription:
    """What a results server must know of one estimator to publish it."""

    name: str
    description: str
    parameter_names: tuple[str, ...]
    has_forgetting_factor: bool
    finds_changes: bool = False
    chooses_structure: bool = False
    finds_lags: bool = False
    has_named_parameters: bool = False  # few, each with a meaning of its own


@dataclass(frozen=True)
class ValveDescription:
    """What a results server must know of one valve; ranges are (low, high)."""

    name: str
    estimators: tuple[EstimatorDescription, ...]
    Q_range: tuple[float, float] = (0.0, 200.0)
    dp_range: tuple[float, float] = (0.0, 200.0)
    map_Q: tuple[float, ...] = ()
    map_dp: tuple[float, ...] = ()
    counters: tuple[str, ...] = ()
    nameplate: Nameplate = BLANK


@dataclass(frozen=True)
class EstimatorResult:
    """One estimator's state of knowledge after one sample.

    ``t`` is the source time (UTC ns) of the sample behind it, ``quality`` becomes the OPC UA
    severity: UNCERTAIN while the parameters are not determined or excitation is poor, BAD when
    the sensors are lost. ``survey`` is made anew with the inverse map; None before the first.
    ``change`` is the last change of the valve that was found, ``structure`` what was chosen,
    ``lags`` those of U's effect and of the flow meter, s; ``systematic_std`` what the sensors'
    errors make of the flow at the newest sample, l/min, NaN where nothing is said of them;
    ``adaptation`` what the estimator makes of its residuals.
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

    ``map_U`` has shape (len(map_Q), len(map_dp)), %; NaN where the valve cannot deliver. ``armed``
    and ``feed_forward`` say whether the answer is written to the valve.
    """

    t: int
    quality: Quality
    required_U: float
    status: int
    map_U: Floats
    armed: bool = False
    feed_forward: FeedForwardStatus = FeedForwardStatus.NOT_CONFIGURED


@dataclass(frozen=True)
class ValveResult:
    """All that is known of one valve at once."""

    valve: int
    estimators: Mapping[str, EstimatorResult]
    inverse: InverseResult
    counters: Mapping[str, int]


@dataclass(frozen=True)
class EstimatorResults:
    """One estimator on M valves: the fields of :class:`EstimatorResult`, all of length M.

    ``theta`` and ``std`` are of shape (M, n); ``old`` says whose newest sample is, None: nobody's.
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


SIGNALS = ("U", "p1", "p2", "Q", "dp", "T")


@dataclass(frozen=True)
class SignalResults:
    """The newest sample of each of M valves, as it came, in our units.

    ``values`` (M, 6) are U, p1, p2, Q, dp and T; NaN is what is not there. ``quality`` (M,) is the
    source's, BAD where the sensors are lost; ``t`` (M,) is 0 before the first sample.
    """

    t: Times
    quality: Codes
    values: Floats


@dataclass(frozen=True)
class AlarmReport:
    """How one alarm stands.

    ``since`` is when it came last, ``at`` when it last came, went or was acknowledged, both UTC ns,
    0 if it never did; ``count`` is how often it came; ``text`` says what was measured, since when,
    and what it may be. ``confirmed`` is False from when it was acknowledged until somebody says
    that it was dealt with; ``limit`` is what it is judged by; ``comment`` is what was said of it
    last, by whom, and when (UTC ns; 0: never).
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
    """What somebody says of an alarm when he does something about it: text, who, when (UTC ns)."""

    text: str
    by: str
    t: int


@dataclass(frozen=True)
class AlarmChange:
    """One change of an alarm, to be kept.

    Whose it is (a valve's name, or the service's), when it changed (UTC ns), how it stood then.
    """

    owner: str
    t: int
    report: AlarmReport


@dataclass(frozen=True)
class AlarmResults:
    """The alarms of M valves.

    ``version`` (M,) grows with whatever changes of any of a valve's alarms; ``reports`` says how
    all of the m-th one's stand, and is asked before anything else is done.
    """

    version: Times
    reports: Callable[[int], Sequence[AlarmReport]]


class Version(Protocol):
    """An approved map: its name, source time of the newest sample behind it (UTC ns), its hash."""

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
    """A map against the approved one: now less then, l/min."""

    @property
    def mean(self) -> float:
        """Over all points."""

    @property
    def largest(self) -> float:
        """With its sign."""

    @property
    def U(self) -> float:
        """Where that is, %."""

    @property
    def dp(self) -> float:
        """Where that is, bar."""

    @property
    def points(self) -> int:
        """How many could be compared."""


@dataclass(frozen=True)
class Results:
    """All that is published of M valves that are treated alike.

    ``valves`` (M,) are their numbers; ``counters`` have a column for each of ``counter_names``;
    ``waiting`` says of each why nothing is learnt from it, ``timing`` how its signals come,
    ``baselines`` names the approved map that its results build on, ``alarms`` how those stand.
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
    alarms: AlarmResults | None = None

    def one(self, m: int) -> ValveResult:
        """What there is of the m-th of them."""
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
class Health:
    """How fresh the data are, and whether what is learnt is safe; arrays over all valves.

    Attributes
    ----------
    age_s : float64
        By how much the newest sample is behind the source's clock, s; NaN before the first.
    waiting : int64
        Samples that wait for signals of theirs, or for earlier samples.
    source, source_states
        What was seen of all sources; a line on each.
    checkpoint_age_s : float
        Since the states were last kept; NaN before.
    checkpoint_failures, checkpoint_bytes, checkpoints_refused : int
        How often they could not be, how much room they take, and how many were found at the start
        that could not be used.
    alarms
        How those of the service stand.
    history
        How the history stands.
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


class ResultSink(Protocol):
    """Where results go; ``publish`` never waits for a reader."""

    async def publish(self, results: Results) -> None:
        """Show results; a later call for the same valve replaces the earlier one."""

    async def doubt(self, valves: Times) -> None:
        """Have what is shown of some valves be at best Uncertain at once: it has become old."""

    async def show_health(self, health: Health) -> None:
        """Show how the service itself stands."""


T = TypeVar("T")
Answer: TypeAlias = T | Awaitable[T]


class Operator(Protocol):
    """What a results server lets people do; it answers at once, or once somebody else has.

    ``valve`` and ``estimator`` are names that the server was built with. A command that cannot be
    carried out raises :class:`~valvemap.errors.CommandRejected` with a sentence.
    """

    def reset(self, valve: str, estimator: str) -> Answer[None]:
        """Forget all samples."""

    def freeze(self, valve: str, estimator: str) -> Answer[None]:
        """Stop adaptation: predict only."""

    def resume(self, valve: str, estimator: str) -> Answer[None]:
        """Adapt again."""

    def set_forgetting_factor(self, valve: str, estimator: str, lam: float) -> Answer[None]:
        """Use another forgetting factor, 0 < lam <= 1, from the next sample on."""

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

    def demand(self, valve: str, Q: float, dp: float) -> Answer[None]:
        """Set the standing demand; NaN takes it back."""

    def approve(self, valve: str) -> Answer[None]:
        """Keep what is known of a valve as its map when new: its baseline."""

    def roll_back(self, valve: str) -> Answer[None]:
        """Go back to the baseline."""

    def replace_valve(self, valve: str) -> Answer[None]:
        """Another valve is there: forget all, the baseline too."""

    def compare(self, valve: str, estimator: str) -> Answer[Compared]:
        """By how much an estimator's map has moved away from the baseline."""

    def baseline(self, valve: int) -> Version | None:
        """The baseline of a valve, by its number."""

    def arm(self, valve: str) -> Answer[None]:
        """Have the answer to the standing demand written to the valve, while it may be."""

    def disarm(self, valve: str) -> Answer[None]:
        """Write nothing to the valve any more."""

    def acknowledge(self, valve: str | None, alarm: str, remark: Remark) -> Answer[None]:
        """Note that somebody has seen an alarm, of a valve or (None) of the service."""

    def confirm(self, valve: str | None, alarm: str, remark: Remark) -> Answer[None]:
        """Note that an alarm that was acknowledged was dealt with."""

    def remark(self, valve: str | None, alarm: str, remark: Remark) -> Answer[None]:
        """Note what somebody said of an alarm."""

    def alarmed(self) -> Iterable[str]:
        """The valves of which any alarm ever came."""

    def alarms(self, valve: str | None) -> Sequence[AlarmReport]:
        """How all alarms of a valve, or (None) of the service, stand."""


class CheckpointStore(Protocol):
    """Keeps the newest state of every estimator over restarts."""

    def save(self, checkpoints: Sequence["Checkpoint"]) -> None:
        """Keep all of them or none.

        Raises
        ------
        StorageError
            naming the file (disk full, read-only, locked).
        """

    def load(self) -> Sequence["Checkpoint"]:
        """All that is kept, newest of each (valve, estimator)."""

    @property
    def size(self) -> int:
        """Bytes that all of it takes."""

    @property
    def damaged(self) -> Sequence[str]:
        """``<Valve>.<Estimator>`` whose newest state could not be believed at `load`."""


@dataclass(frozen=True)
class Checkpoint:
    """One estimator's state as bytes, and what the operator had changed."""

    valve: str
    estimator: str
    key: str
    t: int
    state: bytes
    lam: float | None
    frozen: bool


@dataclass(frozen=True)
class Piece:
    """Successive rows of one series, to be kept.

    Times ``t`` (n,) in UTC ns, OPC UA status ``codes`` (n,), and columns (n,) by name.
    """

    series: str
    t: Times
    codes: NDArray[np.uint32]
    columns: Mapping[str, Floats]


@dataclass(frozen=True)
class Past:
    """What one column of a series was: times (n,) in UTC ns, values (n,), status codes (n,)."""

    t: Times
    values: Floats
    codes: NDArray[np.uint32]

    def __getitem__(self, rows: slice) -> "Past":
        return Past(self.t[rows], self.values[rows], self.codes[rows])


class PastStore(Protocol):
    """Keeps what signals and results were, and gives it back; from any thread, one at a time.

    Attributes
    ----------
    lost : int
        Rows that damage took.
    """

    lost: int

    def save(self, pieces: Iterable[Piece]) -> int:
        """Keep all pieces or none; return how many values were left out as not newer.

        Raises
        ------
        StorageError
            naming the file.
        """

    def forget(self, now: int) -> int:
        """Drop what is too old at ``now`` (UTC ns), or too much; return how many blocks."""

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
        """Rows from ``low`` to ``high`` (UTC ns, both belong to it), but for the first ``skip``."""

    def note(self, changes: Sequence[AlarmChange]) -> None:
        """Keep changes of alarms; those that are kept already are not kept twice.

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
        """Changes of an owner's alarms (None: of all), see :meth:`read`."""

    def take_notes(self) -> Sequence[str]:
        """Sentences about damage since they were last taken."""

    @property
    def size(self) -> int:
        """Bytes that all of it takes."""
