"""A service as the page sees it, without OPC UA: readings by identifier, counted and scripted."""

import math
from dataclasses import dataclass, field

from support import shown_parts
from support.readings import Node, Read
from valvemap.errors import CommandRejected, SourceLost, SourceRejected
from valvemap.vocabulary.edges import split_id

FRAME = (
    "Sequence",
    "RLS.PredictedFlow",
    "RLS.Residual",
    "RLS.ResidualRmse",
    "RLS.NoiseStd",
    "RLS.SampleCount",
    "RLS.Status",
    "RLS.ParameterVector.a1",
    "Inverse.RequiredU",
    "Inverse.RequiredUStatus",
    "Signals.U",
    "Signals.dp",
    "Signals.Q",
)
SIGNALS = (40.0, 100.0, 60.0)
_BAD_USER_ACCESS_DENIED = 0x801F_0000


@dataclass(frozen=True)
class Alarm:
    """Fulfils `valvemap.readings.ConditionChange`."""

    source: str = "V1"
    name: str = "Changed"
    t: int = 1_800_000_000_000_000_000
    text: str = "The flow changed by -4.1 l/min, since 2027-01-15 08:00:00 UTC."
    severity: int = 600
    active: bool = True
    acked: bool = False
    confirmed: bool = True
    retain: bool = True
    comment: str = ""
    user: str = ""
    event: bytes = b"1"
    begun: int = 0

    @property
    def turned(self):
        return (self.begun or self.t) if self.active else 0 if self.acked else self.t


@dataclass(frozen=True)
class Course:
    """Fulfils `valvemap.readings.Course`."""

    code: int
    times: list[int]
    values: list[float]
    codes: list[int]


@dataclass
class ShownService:
    """Fulfils `valvemap.page.ports.Client`."""

    names: tuple[str, ...] = ("V1",)
    url: str = "opc.tcp://127.0.0.1:1/shown/"
    values: dict[str, Read] = field(default_factory=dict)
    t: int = 1_000_000_000
    up: bool = True
    moving: bool = True
    calls: list[tuple] = field(default_factory=list)
    writes: list[tuple] = field(default_factory=list)
    reads: int = 0
    closed: int = 0
    users: dict[str, str] = field(default_factory=dict)
    followed: tuple[str, ...] = ()
    may_follow: bool = True
    may_listen: bool = True
    alarms: list[Alarm] = field(default_factory=list)  # reported when asked for, and as they come
    past: list[Alarm] | None = None
    keeps_history: bool = True
    history: list[tuple] = field(default_factory=list)  # what was asked for
    comments: list[tuple] = field(default_factory=list)
    more: tuple[str, ...] = ()  # parts of each valve
    lines: tuple[str, ...] = ()  # of valves with ports, such as Boom.LineA
    axes: tuple[str, ...] = ()
    rejects: bool = False  # the client altogether
    refused: tuple[str, ...] = ()  # how the nodes begin that may not be read
    may_write: bool = True
    status: float = 0.0  # of the estimators

    async def connect(self):
        self._check()

    async def close(self):
        self.closed += 1

    async def browse(self, id):  # noqa: A002
        self._check()
        if id == "Identification":
            return [Node(name) for name in (*self.names, *self.lines, *self.axes)]
        if part := self._part_of(id):
            variables, objects = shown_parts.below(*part)
            nodes = [Node(f"{id}.{name}", is_variable=True) for name in variables]
            return [*nodes, *(Node(f"{id}.{name}") for name in objects)]
        if id in self.names:
            parts = ("RLS", "Inverse", "Diagnostics", "Signals", "Baseline", *self.more)
            return [Node(f"{id}.Frame", is_variable=True), *(Node(f"{id}.{p}") for p in parts)]
        below = {
            "RLS": (
                *("ParameterStd", "Coverage", "PredictedFlow", "ParameterNames"),
                *("SuggestedU", "SuggestedDp"),
            ),
            "Inverse": ("FlowDemand", "MapDp", "RequiredU"),
            "Diagnostics": (
                *("Aligned", "Late", "Pending", "SampleAge"),
                *("LagQ", "LastAction", "Timing", "Findings", "FindingProbabilities"),
            ),
            "Signals": ("U", "dp", "Q"),
            "Baseline": ("Version",),
            "Commission": ("State", "Progress", "Recording", "Heartbeat"),
        }[id.rpartition(".")[2]]
        return [Node(f"{id}.{name}", is_variable=True) for name in below]

    async def read(self, ids):
        self._check()
        self.reads += len(ids)
        if self.moving:
            self.t += 10_000_000
        return [self._one(id_) for id_ in ids]

    async def engineering(self, ids):
        self._check()
        return [shown_parts.engineering(id_) for id_ in ids]

    async def follow(self, ids, every_s):
        self._check()
        if not self.may_follow:
            self.followed = ()
            raise SourceRejected("no room")
        self.followed = tuple(ids)

    def changes(self):
        self._check()
        if self.moving and self.followed:
            self.t += 10_000_000
        return [(id_, self._one(id_)) for id_ in self.followed if self.moving]

    async def call(self, owner, method, inputs):
        self._check()
        self.calls.append((owner, method, tuple(map(tuple, inputs))))
        if method == "Invert" and owner.rpartition(".")[0] in self.axes:
            return [(v / 4, v / 4 - 1, v / 4 + 1, 0) for v, *_ in inputs]
        if method == "Invert":
            return [(Q / 2, Q / 2 - 1, Q / 2 + 1, 0) for Q, _, _ in inputs]
        if (owner.rpartition(".")[2], method) == ("Baseline", "Predict"):
            return [(U * math.sqrt(dp) + 1.0, 0.5, 0) for _, U, dp, _ in inputs]
        if method == "Compare":
            return [(-1.0, -2.0, 50.0, 100.0, 30) for _ in inputs]
        if method != "Predict":
            return [() for _ in inputs]
        return [(U * math.sqrt(dp), 0.5, 6 if U > 90 else 0) for U, dp, _ in inputs]

    async def write(self, id, value):  # noqa: A002
        self._check()
        self.writes.append((id, value))

    async def listen(self, every_s):
        self._check()
        if not self.may_listen:
            raise SourceRejected("no room")
        self._reported = 0

    def conditions(self):
        self._check()
        new, self._reported = self.alarms[self._reported :], len(self.alarms)
        return new

    async def comment(self, condition, event, text):
        self._check()
        self.comments.append((condition, event, text))

    async def past_conditions(self, span, most):
        self._check()
        if self.past is None:
            raise CommandRejected("keeps no past alarms")
        found = [alarm for alarm in self.past if span[0] <= alarm.t < span[1]]
        return sorted(found, key=lambda alarm: -alarm.t)[:most]

    async def courses(self, asked, span, every_ns):
        """A value of each interval: its number since 1970, modulo 100; of a status, always 0."""
        self._check()
        self.history.append((tuple(asked), span, every_ns))
        if not self.keeps_history:
            return [Course(0x8072_0000, [], [], []) for _ in asked]
        times = list(range(span[0], span[1], every_ns))
        values = [float(t // every_ns % 100) for t in times]
        return [
            Course(0, times, [0.0] * len(times) if id_.endswith("Status") else values, codes)
            for (id_, _), codes in ((one, [0] * len(times)) for one in asked)
        ]

    async def permitted(self, ids):
        self._check()
        return [self.may_write for _ in ids]

    def _check(self):
        if not self.up:
            raise SourceLost("gone")
        if self.rejects:
            raise SourceRejected("the certificate is not trusted")

    def _part_of(self, id_):
        """The variables of the line or axis that a node belongs to, and the node's prefix there."""
        for names, known in ((self.lines, shown_parts.LINE), (self.axes, shown_parts.AXIS)):
            for name in names:
                if id_ == name or id_.startswith(f"{name}."):
                    return known, id_.removeprefix(name).lstrip(".") + "." * (id_ != name)
        return None

    def _one(self, id_):
        if isinstance(id_, str) and id_.startswith(self.refused):
            return Read(None, _BAD_USER_ACCESS_DENIED)
        if id_ in self.values:
            return self.values[id_]
        if isinstance(id_, int):
            return Read(id_ - 2_270)
        if part := self._part_of(id_):
            names, prefix = part
            name = prefix.removesuffix(".")
            return Read(names[name], 0, self.t) if name in names else Read(None, 0x80340000)
        name = split_id(id_)[1]
        count = self.t / 1e7
        known = {
            "Frame": [count, 10.0, 0.1, 0.2, 0.3, count, self.status, 1.5, 30.0, 0.0, *SIGNALS],
            "FrameNames": list(FRAME),
            "RLS.ParameterNames": ["a1"],
            "RLS.ParameterStd": [0.01],
            "RLS.Coverage": [[1.0, 2.0], [3.0, math.nan]],
            "Baseline.Version": "",
            "Signals.U": SIGNALS[0],
            "Signals.dp": SIGNALS[1],
            "Signals.Q": SIGNALS[2],
            "Inverse.MapDp": [0.0, 100.0, 200.0],
            "Diagnostics.Aligned": int(count),
            "Diagnostics.Late": 0,
            "Diagnostics.Pending": 3,
            "Diagnostics.SampleAge": 0.05,
            "Diagnostics.LagQ": 0.2,
            "Diagnostics.LastAction": "",
            "Diagnostics.Timing": ["the signals of a sample carry one time"],
            "Checkpoint.Age": 4.0,
            "Checkpoint.Failures": 1,
            "Checkpoint.Refused": 0,
            "Checkpoint.Size": 4_096,
            "Source.Notifications": int(count),
            "Source.Overflows": 2,
            "Commission.State": 0,
            "Commission.Progress": "not started",
            "RLS.ChangeCount": 0,
            "RLS.PredictedFlow": 10.0,
        }
        if name not in known:
            return Read(None, 0x80340000)
        return Read(known[name], 0, self.t)
