"""A fleet on OPC UA: plays its recording to many valves in real time."""

import asyncio
import dataclasses
import logging
from typing import Self

import numpy as np

from guarded_opcua import (
    Clock,
    HardenedServer,
    ServerSettings,
    Startable,
    SystemClock,
    many_nodes,
)
from valvemap_rig.fleet import FleetRecording, record, valve_names
from valvemap_rig.information_model import FleetNodes, add_fleet
from valvemap_rig.publication import publish_fleet
from valvemap_rig.scenario import Scenario

_log = logging.getLogger(__name__)

_TICK_S = 0.02
_LATE_S = 0.1
_REPORT_S = 1.0
_VALUES_PER_TURN = 200_000
_QUEUED_S = 30.0  # s; queue capacity for all items of one client


class FleetServer(Startable):
    """A server with a fleet of valves; created by :meth:`create`."""

    def __init__(self, server: HardenedServer, scenario: Scenario, clock: Clock) -> None:
        self._server = server
        self._clock = clock
        self._rate = scenario.sample_rate_hz * scenario.time_factor
        self._most = scenario.samples
        self._recording: FleetRecording = record(scenario)
        self._nodes: FleetNodes
        self._samples = 0
        self._late_ticks = 0
        self._report_due = 0.0
        self._over = False

    @classmethod
    async def create(
        cls, settings: ServerSettings, scenario: Scenario, *, clock: Clock | None = None
    ) -> Self:
        """Create the server and its nodes; it does not listen yet.

        Parameters
        ----------
        settings
            Identity, endpoint and security; limits are raised as the fleet needs.
        scenario
            Scenario to play; its ``fleet`` gives the number of valves.
        clock
            Clock; None: the system clock.
        """
        clock = clock or SystemClock()
        names = valve_names(scenario)
        server = await HardenedServer.create(_roomy(settings, scenario), clock)
        fleet = cls(server, scenario, clock)
        with many_nodes():
            fleet._nodes = await add_fleet(server, scenario, names)
        return fleet

    @property
    def url(self) -> str:
        """Endpoint URL of the fleet."""
        return self._server.url

    @property
    def playing(self) -> bool:
        """Whether the scenario still runs."""
        return not self._over

    @property
    def samples(self) -> int:
        """Number of samples of each valve published since the start."""
        return self._samples

    @property
    def late_ticks(self) -> int:
        """Number of times that samples were published more than 0.1 s late."""
        return self._late_ticks

    @property
    def lost(self) -> int:
        """Number of notifications lost because clients' queues were full."""
        return self._server.counters.lost_notifications

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
        """Play until the scenario ends or the task is cancelled; samples are never dropped.

        After a stall, samples are published late, in order, with their nominal source times.
        """
        start_ns, started_at = self._clock.now() // 100 * 100, self._clock.monotonic()
        spacing_ns = 1e9 / self._rate
        most = max(1, _VALUES_PER_TURN // len(self._nodes.signals))
        while self._most is None or self._samples < self._most:
            elapsed = self._clock.monotonic() - started_at
            due = min(int(elapsed * self._rate) + 1 - self._samples, most)
            if self._most is not None:
                due = min(due, self._most - self._samples)
            if due > 0:
                self._publish(due, start_ns, spacing_ns, elapsed - self._samples / self._rate)
            ahead = self._samples / self._rate - (self._clock.monotonic() - started_at)
            await asyncio.sleep(max(ahead, _TICK_S) if ahead > 0 else 0)
        self._over = True

    def _publish(self, n: int, start_ns: int, spacing_ns: float, lag_s: float) -> None:
        index = np.arange(self._samples, self._samples + n)
        t = start_ns + np.rint(index * spacing_ns / 100).astype(np.int64) * 100
        samples = self._recording.samples(self._samples, n)
        publish_fleet(self._server, self._nodes, samples, self._samples, t)
        self._samples += n
        self._late_ticks += lag_s > _LATE_S
        if self._clock.monotonic() >= self._report_due:
            self._report_due = self._clock.monotonic() + _REPORT_S
            now = self._clock.now()
            status = self._nodes.status
            self._server.write(
                status.updates(self._samples, self._late_ticks, lag_s, self.lost, now)
            )


def _roomy(settings: ServerSettings, scenario: Scenario) -> ServerSettings:
    """Raise the limits so that clients can subscribe to all signals of the fleet."""
    limits = settings.limits
    items = 6 * len(valve_names(scenario)) + 100
    second = items * scenario.sample_rate_hz * scenario.time_factor
    return dataclasses.replace(
        settings,
        limits=dataclasses.replace(
            limits,
            monitored_items=max(limits.monitored_items, 3 * items),
            monitored_items_per_subscription=max(limits.monitored_items_per_subscription, items),
            queued_notifications=max(limits.queued_notifications, round(_QUEUED_S * second)),
            unsent_bytes_per_connection=max(limits.unsent_bytes_per_connection, 8 * 1024 * 1024),
        ),
    )
