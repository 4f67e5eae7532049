"""OPC UA server of the rig: plays a scenario in real time and publishes every sample."""

import asyncio
import logging
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
from valvemap_rig.commands_in_force import CommandsInForce
from valvemap_rig.condition import Condition, condition
from valvemap_rig.fault_words import fault_effect
from valvemap_rig.faults import FaultError, commanded_fault
from valvemap_rig.history import RigHistory
from valvemap_rig.information_model import GOOD, RigNodes, add_rig, playable
from valvemap_rig.player import Advance, OnBlock, Player
from valvemap_rig.scenario import Scenario, faultable
from valvemap_rig.simulation import MOST_FAULTS, advance
from valvemap_rig.unit_nodes import Actions

_log = logging.getLogger(__name__)

_UNCERTAIN_LAST_USABLE_VALUE = 0x40900000


class RigServer(Startable):
    """A server with a rig that clients can monitor and operate; created by :meth:`create`."""

    def __init__(self, server: HardenedServer, scenario: Scenario, clock: Clock) -> None:
        self._server, self._base, self._clock = server, scenario, clock
        self._nodes: RigNodes
        self._player: Player
        self._commands = CommandsInForce([unit.name for unit in scenario.units])
        self._units = {unit.name: unit for unit in scenario.units}
        self._changed = asyncio.Event()

    @classmethod
    async def create(
        cls,
        settings: ServerSettings,
        scenario: Scenario,
        *,
        on_block: OnBlock | None = None,
        clock: Clock | None = None,
        advance: Advance = advance,
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
        advance
            Computes the samples; another valve's physics can be played in place of the rig's.
        """
        clock = clock or SystemClock()
        server = await HardenedServer.create(settings, clock)
        rig = cls(server, scenario, clock)
        actions = Actions(
            rig.start_scenario,
            rig.stop_scenario,
            rig.inject_fault,
            rig.command_U,
            rig.command_load,
            rig.heartbeat,
        )
        rig._nodes = nodes = await add_rig(server, scenario, actions)
        history = None
        if scenario.history_s > 0.0:
            rate = scenario.sample_rate_hz * scenario.time_factor
            history = RigHistory(nodes, scenario.history_s, rate)
            server.add_history(history.variables, history)
        rig._player = Player(server, nodes, clock, rig._commands, advance, on_block, history)
        return rig

    @property
    def url(self) -> str:
        """Endpoint URL of the rig."""
        return self._server.url

    @property
    def scenario(self) -> Scenario | None:
        """The running scenario, or None."""
        return self._player.scenario

    @property
    def start_ns(self) -> int:
        """Source time of the running scenario's first sample, UTC ns; 0: none runs."""
        return 0 if self._player.scenario is None else self._player.state.start_ns

    @property
    def samples(self) -> int:
        """Number of samples published since the start."""
        return self._player.samples

    @property
    def late_ticks(self) -> int:
        """Number of times that samples were published more than 0.1 s late."""
        return self._player.late_ticks

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
            scenario = self._player.scenario
            if scenario is None:
                self._changed.clear()
                await self._changed.wait()
                continue
            ahead_s = self._player.play(scenario)
            if ahead_s is None:
                self.stop_scenario()
            await asyncio.sleep(ahead_s or 0.0)

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
        self._player.begin(scenario)
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
        if self._player.scenario is None:
            raise CommandRejected("no scenario is running")
        _log.info("scenario %s stopped", self._player.scenario.name)
        self._player.end()
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
        if self._player.scenario is None:
            raise CommandRejected("no scenario is running")
        try:
            fault = commanded_fault(kind, size, duration_s, faultable(self._units[valve]))
        except FaultError as error:
            raise InvalidArgument(0 if str(error).startswith("kind") else 1, str(error)) from error
        waiting = sum(name == valve for name, _ in self._player.faults)
        if len(self._player.state.faults_of(valve)) + waiting >= MOST_FAULTS:
            raise CommandRejected(f"{valve}: {MOST_FAULTS} faults at once are enough")
        self._player.faults.append((valve, fault))
        effect = fault_effect(fault, self._units[valve], self._base.sensors)
        _log.info("%s: fault %s: %s", valve, kind, effect)
        return effect

    def conditions(self) -> dict[str, Condition]:
        """Return the condition of every valve at the newest computed sample."""
        if self._player.scenario is None:
            return {}
        index = max(self._player.state.index - 1, 0)
        return {
            name: condition(valve.faults, index, self._player.scenario.sample_rate_hz)
            for name, valve in self._player.state.valves.items()
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
