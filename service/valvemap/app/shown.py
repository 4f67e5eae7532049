"""Keeps the results server across reloads of the configuration."""

from collections.abc import Callable

from valvemap.app.plan import Plan
from valvemap.app.reload import Reload
from valvemap.opcua_results.results_server import ResultsServer
from valvemap.pipeline.alarm_results import AlarmChange
from valvemap.storage.history import HistoryFile


class Shown:
    """The results server, kept across a reload unless its own settings change."""

    def __init__(self, reload: Reload) -> None:
        self._reload = reload
        self._server: ResultsServer | None = None
        self._plan: Plan | None = None

    async def server(
        self,
        plan: Plan,
        past: HistoryFile | None,
        on_alarm: Callable[[AlarmChange], None] | None,
    ) -> ResultsServer:
        """Return the server of a plan: the current one with its sessions if possible, else new."""
        valves = plan.identification.descriptions()
        interval_s = plan.config.server.results_interval_ms * 1e-3
        shown = None if self._plan is None else self._plan.identification.descriptions()
        if self._server is not None and self._plan is not None and is_same_server(self._plan, plan):
            try:
                await self._server.follow(valves, plan.identification, interval_s, on_alarm)
            except BaseException:
                await self.end()
                raise
            self._plan = plan
            return self._server
        await self.end()
        server = ResultsServer(
            plan.settings,
            valves,
            plan.identification,
            scalars_interval_s=interval_s,
            on_reload=self._reload.call,
            past=past,
            on_alarm=on_alarm,
            before=shown,
        )
        await server.start()
        self._server, self._plan = server, plan
        return server

    async def end(self) -> None:
        """Close every session."""
        server, self._server = self._server, None
        if server is not None:
            await server.stop()


def is_same_server(before: Plan, plan: Plan) -> bool:
    """Whether the server's settings and security are unchanged, except the results interval."""
    if plan.given_settings is not None:
        return plan.given_settings is before.given_settings
    one, other = (
        (p.config.server.model_dump(exclude={"results_interval_ms"}), p.config.security)
        for p in (before, plan)
    )
    return one == other
