"""Valves of two servers in one service: one that is away holds up nobody."""

import asyncio
from contextlib import asynccontextmanager, suppress

import pytest

from guarded_opcua import ServerSettings
from support.processes import free_port, rig_url
from valvemap.app.build import build_identification
from valvemap.app.serve import serve
from valvemap.config.connections import NamedSourceConfig
from valvemap.config.estimators import RlsConfig
from valvemap.config.valves import ValveConfig
from valvemap_rig.scenario import BUILTIN, ValveBench
from valvemap_rig.server import RigServer


@asynccontextmanager
async def rig_at(url, valve):
    settings = ServerSettings(
        url=url,
        application_uri="urn:valvemap:rig",
        application_name="valvemap rig",
        namespace_uri="urn:valvemap:rig",
        none_on_loopback=True,
    )
    scenario = BUILTIN["scattered"].model_copy(update={"valves": (ValveBench(name=valve),)})
    async with await RigServer.create(settings, scenario) as rig:
        playing = asyncio.create_task(rig.run())
        try:
            yield
        finally:
            playing.cancel()
            with suppress(asyncio.CancelledError):
                await playing


@pytest.fixture
def two(config):
    sources = tuple(
        NamedSourceConfig(name=name, url=rig_url(free_port()), security="None")
        for name in ("north", "south")
    )
    valves = tuple(
        ValveConfig(name=valve, source=source, estimators=(RlsConfig(name="RLS"),))
        for valve, source in (("A", "south"), ("B", "north"))
    )
    return config.model_copy(update={"sources": sources, "valves": valves})


async def test_valves_of_two_servers_are_learnt_and_one_that_is_away_holds_up_nobody(
    two, open_server
):
    identification, stop = build_identification(two), asyncio.Event()

    def learnt(valve):
        return identification.results.one(valve).estimators["RLS"].sample_count

    async def until(enough):
        async with asyncio.timeout(120):
            while not enough():
                assert not serving.done(), serving.exception()
                await asyncio.sleep(0.05)

    north, south = two.sources
    serving = asyncio.create_task(serve(two, stop, open_server, identification))
    try:
        async with rig_at(north.url, "B"):
            await until(lambda: learnt(1) > 100)  # the south was never there
            async with rig_at(south.url, "A"):
                await until(lambda: learnt(0) > 100)
            before = learnt(1)
            await until(lambda: learnt(1) > before + 100)  # it has gone
    finally:
        stop.set()
        await serving
    for valve in (0, 1):
        counters = identification.results.counters(valve)
        assert counters["gaps"] == counters["missing"] == 0
