"""The nodes of the service itself: its health, its alarms and the method Reload."""

from collections.abc import Awaitable, Callable
from functools import partial

from asyncua import ua

from guarded_opcua import HardenedServer, Role, add_method, add_object
from valvemap.opcua_results.answers import answered
from valvemap.opcua_results.companions import Companions
from valvemap.opcua_results.information_model import ALARMS, SERVICE
from valvemap.opcua_results.result_alarms import ResultAlarms
from valvemap.opcua_results.result_health import ResultHealth
from valvemap.opcua_results.result_values import service_values
from valvemap.opcua_results.result_variables import ResultVariables
from valvemap.opcua_results.service_variables import service_variables
from valvemap.pipeline.alarm_results import AlarmReport
from valvemap.pipeline.result_ports import Health

_PARTS = {
    f"{SERVICE}.Checkpoint": "State of the checkpoint: saves, failures, size.",
    f"{SERVICE}.History": "What signals and results have been: whether it is kept.",
    f"{SERVICE}.Start": "Progress of the start: kernels are compiled at the first one.",
    f"{SERVICE}.Source": "Changes and losses of the source since the service started.",
}


class ResultService:
    """Adds the service's nodes and writes them.

    Parameters
    ----------
    server, companions
        The server and its companion namespaces.
    variables
        Adds and writes variables.
    alarms, health
        Publish the alarms and the DeviceHealth of the service.
    on_reload
        Carries out the method Reload; raises CommandRejected on failure. None: no such method.
    """

    def __init__(
        self,
        server: HardenedServer,
        companions: Companions,
        variables: ResultVariables,
        alarms: ResultAlarms,
        health: ResultHealth,
        on_reload: Callable[[], Awaitable[None]] | None,
    ) -> None:
        self._server = server
        self._companions = companions
        self._variables = variables
        self._alarms = alarms
        self._health = health
        self._on_reload = on_reload
        self._reports: tuple[AlarmReport, ...] = ()

    async def add(self, root: ua.NodeId) -> None:
        """Add all nodes below the root."""
        server = self._server
        folder = await add_object(
            server, root, SERVICE, description="How the service itself stands."
        )
        server.let_emit(folder)
        server.refer_to_conditions(folder, self._alarms.keys(None))
        self._health.add(SERVICE, await self._companions.add_health(folder, "service"), None)
        for part, variables in service_variables().items():
            parent = await add_object(server, folder, part, description=_PARTS[part])
            for node in variables:
                await self._variables.add(server, parent, node, None)
        parent = await add_object(
            server, folder, f"{SERVICE}.{ALARMS}", description="What the service itself needs."
        )
        show = self._variables.add_standing
        server.add_later(parent, partial(self._alarms.add, parent, None, show))
        if self._on_reload is not None:
            await add_method(
                server,
                folder,
                f"{SERVICE}.Reload",
                partial(answered, self._on_reload, _done),
                required=Role.ENGINEER,
                description="Read the configuration again. Unchanged valves keep their state and "
                "lose no sample; a faulty configuration is refused and the present one remains.",
            )

    def show(self, health: Health, now: int) -> None:
        """Publish the state of the service; ``now`` in UTC ns."""
        self._variables.write(service_values(health), now)
        self._health.stands(SERVICE, health.alarms)
        if health.alarms != self._reports:
            self._reports = tuple(health.alarms)
            self._alarms.take(SERVICE, health.alarms, now)


def _done(_: None) -> None:
    """Reload returns no output arguments."""
