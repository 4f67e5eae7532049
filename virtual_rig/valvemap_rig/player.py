"""A scenario in real time: its samples are computed ahead, and published when they are due."""

from collections.abc import Callable

from guarded_opcua import Clock, HardenedServer
from valvemap_rig.blocks import RigBlock
from valvemap_rig.commands_in_force import CommandsInForce
from valvemap_rig.excitation import External
from valvemap_rig.faults import Fault
from valvemap_rig.history import RigHistory
from valvemap_rig.information_model import RigNodes
from valvemap_rig.publication import NOTHING, Columns, columns_of, part, publish
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import Commands, RigState, initial, is_over

_TICK_S = 0.02
_AHEAD_S = 0.1  # s; the cost of a block hardly depends on its length
_COMMANDED_AHEAD_S = 0.02  # s; external commands take effect in the next block
_LATE_S = 0.1
_REPORT_S = 1.0
_SAMPLES_PER_TURN = 200

Advance = Callable[[Scenario, RigState, int, Commands], tuple[RigState, RigBlock]]
OnBlock = Callable[[RigBlock], None]


class Player:
    """Computes the samples of the running scenario and writes them to the server.

    Samples are never dropped: after a stall, they are published late, in order, with their nominal
    source times.

    Parameters
    ----------
    server, nodes
        The server, and the nodes that show the samples.
    clock
        Time at which samples are due.
    commands
        The clients' commands; each block begins with those in force.
    advance
        Computes the next samples, see :func:`valvemap_rig.simulation.advance`.
    on_block
        Called with each block of published samples; None: no call.
    history
        Keeps the published samples; None: there is no history.

    Attributes
    ----------
    scenario : Scenario or None
        The running scenario.
    state : RigState
        Its state after the newest computed sample; unset before the first scenario.
    faults : list of (str, Fault)
        Injected faults by name of valve or machine; they begin with the next block.
    samples : int
        Number of samples published since the start.
    late_ticks : int
        Number of times that samples were published more than 0.1 s late.
    """

    state: RigState

    def __init__(
        self,
        server: HardenedServer,
        nodes: RigNodes,
        clock: Clock,
        commands: CommandsInForce,
        advance: Advance,
        on_block: OnBlock | None,
        history: RigHistory | None,
    ) -> None:
        self.scenario: Scenario | None = None
        self.faults: list[tuple[str, Fault]] = []
        self.samples = 0
        self.late_ticks = 0
        self._server, self._nodes, self._clock = server, nodes, clock
        self._commands, self._advance = commands, advance
        self._on_block, self._history = on_block, history
        self._started_at = 0.0
        self._block = NOTHING
        self._columns: Columns
        self._taken = 0  # published samples of the block
        self._played = 0  # published samples of the scenario
        self._sequence_offset = 0
        self._report_due = 0.0

    def begin(self, scenario: Scenario) -> None:
        """Play a scenario from its beginning, in place of the running one."""
        self.end()
        self.state = initial(scenario, self._clock.now())
        self._started_at = self._clock.monotonic()
        self.faults.clear()
        self.scenario = scenario

    def end(self) -> None:
        """Drop the running scenario; running numbers continue with the next one."""
        self._sequence_offset += self._played
        self._block, self._taken, self._played = NOTHING, 0, 0
        self.scenario = None

    def play(self, scenario: Scenario) -> float | None:
        """Publish the due samples of the running scenario.

        Returns
        -------
        float or None
            Time until the next samples, s; None: all samples of the scenario are published.

        Raises
        ------
        Exception
            any exception of ``on_block``.
        """
        rate = scenario.sample_rate_hz * scenario.time_factor
        elapsed = self._clock.monotonic() - self._started_at
        due = min(int(elapsed * rate) + 1 - self._played, _SAMPLES_PER_TURN)
        while due > 0 and self.scenario is scenario:
            if self._taken == len(self._block):
                if is_over(scenario, self.state):
                    return None
                self._compute(scenario, rate)
            n = min(due, len(self._block) - self._taken)
            self._publish(n, elapsed - self._played / rate)
            due -= n
        ahead = self._played / rate - elapsed
        return max(ahead, min(_TICK_S, 1 / rate)) if ahead > 0 else 0.0

    def _compute(self, scenario: Scenario, rate: float) -> None:
        commands = Commands(
            U=self._commands.U(scenario, self._clock.monotonic()),
            load=self._commands.loads(self.state.valves),
            faults=tuple(self.faults),
        )
        self.faults.clear()
        commanded = isinstance(scenario.excitation, External) or any(
            machine.takes_commands for machine in scenario.machines
        )
        ahead_s = _COMMANDED_AHEAD_S if commanded else _AHEAD_S
        n = min(max(round(rate * ahead_s), 1), _SAMPLES_PER_TURN)
        self.state, self._block = self._advance(scenario, self.state, n, commands)
        self._columns = columns_of(self._block, self._sequence_offset)
        self._taken = 0

    def _publish(self, n: int, lag_s: float) -> None:
        first, self._taken = self._taken, self._taken + n
        rows = slice(first, self._taken)
        publish(self._server, self._nodes, self._columns, rows)
        if self._history is not None:
            self._history.keep(self._columns, rows, self._clock.now())
        self._played += n
        self.samples += n
        self.late_ticks += lag_s > _LATE_S
        if self._clock.monotonic() >= self._report_due:
            self._report(lag_s)
        if self._on_block is not None:
            self._on_block(part(self._block, first, self._taken))

    def _report(self, lag_s: float) -> None:
        self._report_due = self._clock.monotonic() + _REPORT_S
        status, lost = self._nodes.status, self._server.counters.lost_notifications
        self._server.write(
            status.updates(self.samples, self.late_ticks, lag_s, lost, self._clock.now())
        )
