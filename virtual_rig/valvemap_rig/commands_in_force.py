"""The external commands of all valves and machines that apply to the next block."""

import logging
import math
from collections.abc import Iterable

from valvemap_rig.command import Command, lead_of
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import own_command

_log = logging.getLogger(__name__)


class CommandsInForce:
    """Commands as clients write them, and what remains of them when a heartbeat stops.

    Parameters
    ----------
    names
        Names of the valves and machines.

    Examples
    --------
    >>> from valvemap_rig.scenario import BUILTIN
    >>> commands = CommandsInForce(["Valvistor"])
    >>> commands.write_U("Valvistor", 40.0)
    >>> commands.U(BUILTIN["external"], now=0.0), commands.loads(["Valvistor"])
    ({'Valvistor': 40.0}, {'Valvistor': nan})
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._commands = {name: Command() for name in names}
        self._leads: dict[str, float] = {}  # of machines, %
        self._led_at = 0.0

    def write_U(self, name: str, U: float) -> None:
        """Set the control signal (%) of a valve or machine."""
        self._commands[name] = self._commands[name].written(U)

    def write_load(self, name: str, load: float) -> None:
        """Set the load's set point (bar) of a valve."""
        self._commands[name] = self._commands[name].loaded(load)

    def beat(self, name: str, count: int, now: float) -> None:
        """Set the heartbeat of the client that commands a valve or machine, at ``now`` (s)."""
        self._commands[name] = self._commands[name].beaten(count, now)

    def U(self, scenario: Scenario, now: float) -> dict[str, float]:
        """Return the control signals (%) by name at ``now`` (s), after a check of the watchdogs.

        A machine's is added to the command of its controller.
        """
        own = own_command(scenario)
        for name, before in self._commands.items():
            command = before.seen(now)
            if command.dropped and not before.dropped:
                _log.warning("%s: heartbeat stands still, U is the rig's own again", name)
            self._commands[name] = command
        given = {name: command.in_force for name, command in self._commands.items()}
        passed_s, self._led_at = now - self._led_at, now
        self._leads = {
            machine.name: lead_of(
                self._commands[machine.name], self._leads.get(machine.name, 0.0), passed_s
            )
            for machine in scenario.machines
        }
        return {name: own if U is None else U for name, U in given.items()} | self._leads

    def loads(self, valves: Iterable[str]) -> dict[str, float]:
        """Return the set points of the load (bar) of these valves, NaN for the rig's own."""
        given = {valve: self._commands[valve].load_in_force for valve in valves}
        return {valve: math.nan if load is None else load for valve, load in given.items()}
