"""OPC UA server of the rig: plays a scenario in real time and publishes every sample."""

import asyncio
import logging
from collections.abc import Callable
from typing import Self

from guarded_opcua import (
    Clock,
    CommandRejected,
    HardenedServer,
    InvalidArgument,
    ServerSettings,
    Startable,
    SystemClock,
)
from valvemap_rig.blocks import RigBlock
from valvemap_rig.commands_in_force import CommandsInForce
from valvemap_rig.condition import Condition, condition
from valvemap_rig.excitation import External
from valvemap_rig.fault_words import fault_effect
from valvemap_rig.faults import Fault, FaultError, commanded_fault
from valvemap_rig.history import RigHistory
from valvemap_rig.information_model import GOOD, RigNodes, add_rig, playable
from valvemap_rig.publication import NOTHING, Columns, columns_of, part, publish
from valvemap_rig.scenario import Scenario, faultable
from valvemap_rig.simulation import MOST_FAULTS, Commands, RigState, advance, initial, is_over
from valvemap_rig.unit_nodes import Actions

_log = logging.getLogger(__name__)

_TICK_S = 0.02
_AHEAD_S = 0.1  # s; the cost of a block hardly depends on its length
_COMMANDED_AHEAD_S = 0.02  # s; external commands take effect in the next block
_LATE_S = 0.1
_REPORT_S = 1.0
_SAMPLES_PER_TURN = 200
_UNCERTAIN_LAST_USABLE_VALUE = 0x40900000

OnBlock = Callable[[RigBlock], None]


class RigServer(Startable):
    """A server with a rig that clients can monitor and operate; created by :meth:`create`."""

    def __init__(
        self,
        server: HardenedServer,
        scenario: Scenario,
        on_block: OnBlock | None,
        clock: Clock,
    ) -> None:
        self._server = server
        self._base = scenario
        self._on_block = on_block
        self._clock = clock
        self._nodes: RigNodes
        self._history: RigHistory | None = None
        self._scenario: Scenario | None = None
        self._state: RigState
        self._started_at = 0.0
        self._block = NOTHING
        self._columns: Columns
        self._taken = 0  # published samples of the block
        self._played = 0  # published samples of the scenario
        self._sequence_offset = 0
        self._samples = 0
        self._late_ticks = 0
        self._report_due = 0.0
        self._commands = CommandsInForce([unit.name for unit in scenario.units])
        self._units = {unit.name: unit for unit in scenario.units}
        self._faults: list[tuple[str, Fault]] = []
        self._changed = asyncio.Event()

    @classmethod
    async def create(
        cls,
        settings: ServerSettings,
        scenario: Scenario,
        *,
        on_block: OnBlock | None = None,
        clock: Clock | None = None,
    ) -> Self:
        """Create the server and its nodes; it does not listen yet.

        Parameters
        ----------
        settings
            Identity, endpoint and security.
        scenario
            First scenario of :meth:`run`; its valves, sensors and rates apply to all later ones.
        on_block
            Called with each block of samples, e.g. to record it.
        clock
            Clock; None: the system clock.
        """
        clock = clock or SystemClock()
        server = await HardenedServer.create(settings, clock)
        rig = cls(server, scenario, on_block, clock)
        actions = Actions(
            rig.start_scenario,
            rig.stop_scenario,
            rig.inject_fault,
            rig.command_U,
            rig.command_load,
            rig.heartbeat,
        )
        rig._nodes = await add_rig(server, scenario, actions)
        if scenario.history_s > 0.0:
            rate = scenario.sample_rate_hz * scenario.time_factor
            rig._history = RigHistory(rig._nodes, scenario.history_s, rate)
            server.add_history(rig._history.variables, rig._history)
        return rig

    @property
    def url(self) -> str:
        """Endpoint URL of the rig."""
        return self._server.url

    @property
    def scenario(self) -> Scenario | None:
        """The running scenario, or None."""
        return self._scenario

    @property
    def start_ns(self) -> int:
        """Source time of the running scenario's first sample, UTC ns; 0: none runs."""
        return 0 if self._scenario is None else self._state.start_ns

    @property
    def samples(self) -> int:
        """Number of samples published since the start."""
        return self._samples

    @property
    def late_ticks(self) -> int:
        """Number of times that samples were published more than 0.1 s late."""
        return self._late_ticks

    async def start(self) -> None:
        """Start listening.

        Raises
        ------
        ServerError, CertificateError
        """
        await self._server.start()

    async def stop(self) -> None:
        """Stop listening; safe to call twice."""
        await self._server.stop()

    async def run(self) -> None:
        """Play the scenario, then the ones that operators start, until cancelled.

        Samples are never dropped: after a stall, they are published late, in order, with their
        nominal source times.

        Raises
        ------
        Exception
            any exception of ``on_block``, e.g. on a full disk.
        """
        self.start_scenario(self._base.name)
        while True:
            if self._scenario is None:
                self._changed.clear()
                await self._changed.wait()
                continue
            await asyncio.sleep(self._play(self._scenario))

    def start_scenario(self, name: str) -> None:
        """Start a scenario from its beginning.

        Raises
        ------
        InvalidArgument
            if there is no scenario with that name.
        """
        known = playable(self._base)
        if name not in known:
            raise InvalidArgument(0, f"scenario {name!r}: allowed are {', '.join(known)}")
        kept = ("valves", "machines", "sensors", "sample_rate_hz", "time_factor", "seed")
        scenario = known[name].model_copy(update={key: getattr(self._base, key) for key in kept})
        self._leave()
        self._state = initial(scenario, self._clock.now())
        self._started_at = self._clock.monotonic()
        self._faults.clear()
        self._scenario = scenario
        self._server.write([(self._nodes.scenario, name, GOOD, self._clock.now())])
        self._changed.set()
        _log.info("scenario %s started", name)

    def stop_scenario(self) -> None:
        """Stop the running scenario; the last published values become Uncertain.

        Raises
        ------
        CommandRejected
            if no scenario is running.
        """
        if self._scenario is None:
            raise CommandRejected("no scenario is running")
        _log.info("scenario %s stopped", self._scenario.name)
        self._leave()
        now = self._clock.now()
        self._server.write([(self._nodes.scenario, "", GOOD, now)])
        self._server.mark_block(self._nodes.signals, _UNCERTAIN_LAST_USABLE_VALUE)

    def inject_fault(self, valve: str, kind: str, size: float, duration_s: float) -> str:
        """Inject a fault, effective within 0.1 s; return its effect as a sentence.

        Raises
        ------
        InvalidArgument
            if kind or size is invalid; the message names the allowed values.
        CommandRejected
            if no scenario runs, or there are too many faults.
        """
        if self._scenario is None:
            raise CommandRejected("no scenario is running")
        try:
            fault = commanded_fault(kind, size, duration_s, faultable(self._units[valve]))
        except FaultError as error:
            raise InvalidArgument(0 if str(error).startswith("kind") else 1, str(error)) from error
        waiting = sum(name == valve for name, _ in self._faults)
        if len(self._state.faults_of(valve)) + waiting >= MOST_FAULTS:
            raise CommandRejected(f"{valve}: {MOST_FAULTS} faults at once are enough")
        self._faults.append((valve, fault))
        effect = fault_effect(fault, self._units[valve], self._base.sensors)
        _log.info("%s: fault %s: %s", valve, kind, effect)
        return effect

    def conditions(self) -> dict[str, Condition]:
        """Return the condition of every valve at the newest computed sample."""
        if self._scenario is None:
            return {}
        index = max(self._state.index - 1, 0)
        return {
            name: condition(valve.faults, index, self._scenario.sample_rate_hz)
            for name, valve in self._state.valves.items()
        }

    def command_U(self, valve: str, U: float) -> None:
        """Set the external control signal (%), used within 0.02 s by the external excitation."""
        self._commands.write_U(valve, U)

    def command_load(self, valve: str, load: float) -> None:
        """Set the load's set point (bar), used as `command_U` is."""
        self._commands.write_load(valve, load)

    def heartbeat(self, valve: str, count: int) -> None:
        """Set the heartbeat of the client that commands; see :mod:`valvemap_rig.command`."""
        self._commands.beat(valve, count, self._clock.monotonic())

    def _leave(self) -> None:
        self._sequence_offset += self._played
        self._block, self._taken, self._played = NOTHING, 0, 0
        self._scenario = None

    def _play(self, scenario: Scenario) -> float:
        """Publish the due samples; return the time until the next samples, s."""
        rate = scenario.sample_rate_hz * scenario.time_factor
        elapsed = self._clock.monotonic() - self._started_at
        due = min(int(elapsed * rate) + 1 - self._played, _SAMPLES_PER_TURN)
        while due > 0 and self._scenario is scenario:
            if self._taken == len(self._block):
                if is_over(scenario, self._state):
                    self.stop_scenario()
                    return 0.0
                self._compute(scenario, rate)
            n = min(due, len(self._block) - self._taken)
            self._publish(n, elapsed - self._played / rate)
            due -= n
        ahead = self._played / rate - elapsed
        return max(ahead, min(_TICK_S, 1 / rate)) if ahead > 0 else 0.0

    def _compute(self, scenario: Scenario, rate: float) -> None:
        commands = Commands(
            U=self._commands.U(scenario, self._clock.monotonic()),
            load=self._commands.loads(self._state.valves),
            faults=tuple(self._faults),
        )
        self._faults.clear()
        commanded = isinstance(scenario.excitation, External) or any(
            machine.takes_commands for machine in scenario.machines
        )
        ahead_s = _COMMANDED_AHEAD_S if commanded else _AHEAD_S
        n = min(max(round(rate * ahead_s), 1), _SAMPLES_PER_TURN)
        self._state, self._block = advance(scenario, self._state, n, commands)
        self._columns = columns_of(self._block, self._sequence_offset)
        self._taken = 0

    def _publish(self, n: int, lag_s: float) -> None:
        first, self._taken = self._taken, self._taken + n
        rows = slice(first, self._taken)
        publish(self._server, self._nodes, self._columns, rows)
        if self._history is not None:
            self._history.keep(self._columns, rows, self._clock.now())
        self._played += n
        self._samples += n
        self._late_ticks += lag_s > _LATE_S
        if self._clock.monotonic() >= self._report_due:
            self._report(lag_s)
        if self._on_block is not None:
            self._on_block(part(self._block, first, self._taken))

    def _report(self, lag_s: float) -> None:
        self._report_due = self._clock.monotonic() + _REPORT_S
        status, lost = self._nodes.status, self._server.counters.lost_notifications
        self._server.write(
            status.updates(self._samples, self._late_ticks, lag_s, lost, self._clock.now())
        )
