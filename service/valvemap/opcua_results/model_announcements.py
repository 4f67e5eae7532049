"""Announcements of model changes: the root's NodeVersion, and an event for caching clients."""

from collections.abc import Sequence
from typing import Final

from asyncua import ua

from guarded_opcua import Clock, HardenedServer
from valvemap.opcua_results.information_model import NODE_VERSION, ROOT
from valvemap.opcua_results.model_changes import axes_change, model_change, version_of_root
from valvemap.opcua_results.result_types import VALVE, type_of
from valvemap.pipeline.results import ValveDescription

_KEPT_S: Final = 600.0  # s; a model change event is kept for clients that reconnect


class ModelAnnouncements:
    """Announces which valves and axes one server shows from now on."""

    def __init__(self, server: HardenedServer, clock: Clock) -> None:
        self._server = server
        self._clock = clock
        self._axes: tuple[str, ...] | None = None  # none were asked for yet

    def note_axes(self, axes: Sequence[str]) -> tuple[str, ...]:
        """Note the axes to be shown; return those before, which at the first call are the same."""
        before = tuple(axes) if self._axes is None else self._axes
        self._axes = tuple(axes)
        return before

    def announce_axes(
        self, before: Sequence[str], after: Sequence[str], valves: Sequence[ValveDescription]
    ) -> None:
        """Announce the axes shown beside these valves."""
        self._renew_version(valves)
        event = axes_change(before, after, self._server.namespace_index, self._clock.now())
        if event is not None:
            self._server.events.stand(event, _KEPT_S)

    def announce_valves(
        self, before: Sequence[ValveDescription], after: Sequence[ValveDescription]
    ) -> None:
        """Announce the shown valves, if they differ from those before."""
        kind, now = type_of(self._server, VALVE), self._clock.now()
        event = model_change(before, after, self._server.namespace_index, kind, now)
        if event is not None:
            self._renew_version(after)
            self._server.events.stand(event, _KEPT_S)

    def _renew_version(self, valves: Sequence[ValveDescription]) -> None:
        node = ua.NodeId(f"{ROOT}.{NODE_VERSION}", self._server.namespace_index)
        version = version_of_root(valves, self._axes or ())
        self._server.write_property(node, ua.Variant(version, ua.VariantType.String))
