"""The inverse of a line: the edge and the U that pass a demanded flow. Pure.

The sign of the demand selects the edge; what the line loses is added to its flow. U is signed, as
the valve takes it.
"""

from typing import NamedTuple

import numpy as np

from valvemap.model.inversion import Inversion
from valvemap.pipeline import required_signal
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.edges import LEAK
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.sample_intake import SampleIntake
from valvemap.vocabulary.edges import Edge, edges_of
from valvemap.vocabulary.signals import PUBLISHED
from valvemap.vocabulary.statuses import InverseStatus, LineEdge

_DP = PUBLISHED.index("dp")
_NOTHING = np.full(1, np.nan)


class LineAnswer(NamedTuple):
    """U and its 95 % interval, %, the status, and the edge."""

    U: float
    lower: float
    upper: float
    status: InverseStatus
    edge: LineEdge

    def as_inversion(self) -> Inversion:
        """Return the answer in the form of a valve's."""
        numbers = (np.array([x]) for x in (self.U, self.lower, self.upper))
        U, lower, upper = numbers
        return Inversion(U, lower, upper, np.array([self.status], np.uint8))


NO_ANSWER = LineAnswer(np.nan, np.nan, np.nan, InverseStatus.NOT_FINITE, LineEdge.NONE)


class LineInverse:
    """Answers demands on the lines of valves with ports.

    Parameters
    ----------
    valves
        The valves.
    intake
        Holds the newest pressures.
    """

    def __init__(self, valves: AllValves, intake: SampleIntake) -> None:
        self._valves = valves
        self._intake = intake

    def is_line(self, valve: int) -> bool:
        """Whether a plan is a line."""
        part = self._valves.plans[valve].part
        return part is not None and part.edge is None

    def required(self, line: int) -> LineAnswer:
        """Return the answer to a line's standing demand.

        The pressure drop is that of the newest sample, unless one was demanded.
        """
        fleet, m = self._valves.at(line)
        Q, dp = fleet.inputs.demand[m].tolist()
        return self.invert(line, Q, dp, np.nan)

    def invert(self, line: int, Q: float, dp: float, T: float) -> LineAnswer:
        """Return U for a flow out of a line's port (l/min), negative into it.

        If ``dp`` or ``T`` is NaN, that of the newest sample is used.
        """
        part = self._valves.plans[line].part
        assert part is not None  # noqa: S101 - callers check
        if not np.isfinite(Q):
            return NO_ANSWER
        if Q == 0.0:
            return LineAnswer(0.0, 0.0, 0.0, InverseStatus.OK, LineEdge.NONE)
        first, second = edges_of(part.line)
        edge = first if Q > 0.0 else second
        number = self._valves.numbers.get(f"{part.valve}.{edge}")
        if number is None:
            return NO_ANSWER._replace(status=InverseStatus.UNIDENTIFIED)
        leakage = self._leakage(line)
        dp = float(self._intake.newest.values[number, _DP]) if np.isnan(dp) else dp
        return self._of_edge(number, edge, edge.adds * (Q - leakage), dp, T)

    def leakages(self, lines: list[int]) -> tuple[list[float], list[float]]:
        """Return the leakage of lines and its standard deviation, l/min/bar; NaN while unknown."""
        found = [self._valves.lane(self._valves.plans[line].name, LEAK) for line in lines]
        pairs = [lane.estimator.parameters(lane.state) for lane in found]
        return [float(c[0]) for c, _ in pairs], [float(std[0]) for _, std in pairs]

    def _leakage(self, line: int) -> float:
        """Leakage in a line's flow at the newest sample, l/min; 0 before the first."""
        fleet, m = self._valves.at(line)
        lane, dp = fleet.lane(m, LEAK), self._intake.newest.values[line, _DP : _DP + 1]
        found, _ = lane.estimator.predict(lane.state, 0.0 * dp, dp, _NOTHING)
        return float(np.nan_to_num(found[0]))

    def _of_edge(self, number: int, edge: Edge, Q: float, dp: float, T: float) -> LineAnswer:
        code, name = LineEdge[edge.name], self._valves.inverse(number)
        if Q <= 0.0:  # the leakage alone is more than is demanded
            return LineAnswer(0.0, 0.0, 0.0, InverseStatus.BELOW_REACH, code)
        if self._valves.runs(number, name):
            with self._valves.bulkhead(number, Step.INVERSE, name):
                plan, state = self._valves.inverted(number)
                found = required_signal.demanded(plan, state, Q, dp, T)
                ends = sorted(edge.opens * float(x[0]) for x in (found.lower, found.upper))
                status = InverseStatus(int(found.status[0]))
                return LineAnswer(edge.opens * float(found.U[0]), ends[0], ends[1], status, code)
        return NO_ANSWER._replace(status=InverseStatus.UNIDENTIFIED, edge=code)
