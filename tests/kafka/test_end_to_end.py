"""Rig, collector, broker, two workers, results server, client: the bits of one machine."""

import asyncio
import sys
from contextlib import ExitStack, asynccontextmanager
from pathlib import Path

import numpy as np
import pytest

from support.broker import artifacts, brokers
from support.fleet_rig import played, rig_of, scenario_of, site_file
from support.processes import free_port, program, run, running, wait_for

pytest.importorskip("confluent_kafka")

from asyncua import Client, ua

from support import fleet_server
from support.kafka import everything, members, until
from valvemap.app.build import build_identification
from valvemap.config.loading import load_config
from valvemap.kafka.blocks import read_samples
from valvemap.kafka.commands import is_reply
from valvemap.kafka.result_blocks import read_results
from valvemap_rig.fleet import valve_names

pytestmark = [pytest.mark.broker, pytest.mark.timeout(1_200)]

ESTIMATORS = ("RLS", "RML", "RBF")
AT_ONCE = 500  # nodes that a request reads
PASSWORD = "a long enough password"


def node(client, name):
    """A node of ours: the server's own namespace is that of the application."""
    return client.get_node(ua.NodeId(name, 1))


class Fleet:
    """All parts of a fleet, each a process of its own."""

    def __init__(self, folder, broker, scenario, per_group, partitions):
        self.folder, self.broker, self.scenario = folder, broker, scenario
        self.file = folder / "fleet.toml"
        self.port = free_port()
        self.file.write_text(
            f"[broker]\naddresses = ['{broker}']\n"
            f"[topics]\nprefix = 'e'\npartitions = {partitions}\nreplication = 1\n"
            f"[catalogue]\nvalves_per_group = {per_group}\nsites = {{ north = 'north.toml' }}\n"
            f"[collect]\nspool = '{folder / 'spool'}'\n"
            "[work]\nresults_s = 0\ntakeover_s = 6\n[serve]\nanswer_s = 60\nstale_after_s = 60\n",
            encoding="utf-8",
        )
        self.url = f"opc.tcp://127.0.0.1:{self.port}/valvemap/service/"

    def log(self, name):
        return self.folder / f"{name}.log"

    def part(self, name, *command):
        """A process of the fleet, that is interrupted at the end."""
        one_thread = {"NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        state = {"VALVEMAP_FLEET_WORK__STATE": str(self.folder / name)}
        return running(
            "fleet", *command, "-c", str(self.file), env=one_thread | state, log=self.log(name)
        )

    def server(self, name):
        script = Path(fleet_server.__file__)
        command = sys.executable, "-u", script, self.file, str(self.port), PASSWORD
        return program(*command, log=self.log(name))

    async def said(self, name, text, process):
        return await asyncio.to_thread(wait_for, self.log(name), text, process, 240.0)

    @asynccontextmanager
    async def client(self):
        client = Client(self.url, timeout=60.0, watchdog_intervall=60.0)
        client.set_user("operator")
        client.set_password(PASSWORD)
        async with client:
            yield client

    async def shown(self, kind):
        """A variable of each valve's estimators, as a client reads it."""
        names = [(name, e) for name in valve_names(self.scenario) for e in ESTIMATORS]
        async with self.client() as client:
            nodes = [node(client, f"{name}.{estimator}.{kind}") for name, estimator in names]
            found = []
            for first in range(0, len(nodes), AT_ONCE):
                some = nodes[first : first + AT_ONCE]
                found += await client.read_attributes(some, ua.AttributeIds.Value)
            return {name: one.Value.Value for name, one in zip(names, found, strict=True)}

    async def until_all_is_shown(self, samples, seconds=240.0):
        async with asyncio.timeout(seconds):
            while set((await self.shown("SampleCount")).values()) != {samples}:  # noqa: ASYNC110
                await asyncio.sleep(0.5)


def one_machine(config, scenario, t):
    """What `serve` alone comes to after the same samples."""
    alone = build_identification(config)
    for number, (name, samples) in enumerate(played(scenario, t).items()):
        assert alone.plans[number].name == name
        alone.take_samples(number, samples)
    return alone


def times_of(broker):
    """When the samples of the first valve were, by the blocks that were sent."""
    blocks = {}
    for message in everything(broker, "e.samples"):
        block = read_samples(message.value())
        if block.group == "north.0":
            blocks[block.number] = block.samples[0].t
    return np.concatenate([blocks[number] for number in sorted(blocks)])


def check_no_result_contradicts_another(broker):
    """Results of one valve after one block are the same, whoever published them."""
    known = {}
    for message in everything(broker, "e.results"):
        if is_reply(message.value()):
            continue
        block = read_results(message.value())
        theta = block.results.estimators["RLS"].theta
        for valve, own in zip(block.results.valves, theta, strict=True):
            key = block.valves[valve], block.number
            assert known.setdefault(key, own.tobytes()) == own.tobytes()


async def check_bits(fleet, scenario):
    """What clients see, bit for bit."""
    config = load_config(fleet.folder / "north.toml")
    t = await asyncio.to_thread(times_of, fleet.broker)
    assert len(t) == scenario.samples
    alone = await asyncio.to_thread(one_machine, config, scenario, t)
    shown = await fleet.shown("ParameterVector")
    for (name, estimator), theta in shown.items():
        lane = alone.valves.lane(name, estimator)
        expected, _ = lane.estimator.parameters(lane.state)
        np.testing.assert_array_equal(theta, expected, err_msg=f"{name}.{estimator}")
    await asyncio.to_thread(check_no_result_contradicts_another, fleet.broker)


@pytest.fixture
def kafka(request, tmp_path):
    jars = artifacts(request.config.cache.mkdir("kafka"))
    with brokers(jars, tmp_path / "kafka") as (one,):
        yield one


async def trial(kafka, folder, scenario, per_group, partitions, *, second_s):
    """Kill each part once while the rig plays, and compare at the end."""
    fleet = Fleet(folder, f"127.0.0.1:{kafka.port}", scenario, per_group, partitions)
    async with await rig_of(scenario, folder) as rig:
        site_file(folder / "north.toml", scenario, rig.url, ESTIMATORS)
        assert run("fleet", "topics", "-c", str(fleet.file)).returncode == 0
        with ExitStack() as parts:
            first = parts.enter_context(fleet.part("worker1", "work"))
            second = parts.enter_context(fleet.part("worker2", "work"))
            shows = parts.enter_context(fleet.server("serve1"))
            collects = parts.enter_context(fleet.part("collect1", "collect"))
            await fleet.said("collect1", "source connected", collects)
            await fleet.said("serve1", "results served", shows)
            await asyncio.to_thread(until, lambda: members(fleet.broker, "e.work") == 2)
            playing = asyncio.create_task(rig.run())
            await asyncio.sleep(3.0 * second_s)
            first.kill()
            await asyncio.sleep(second_s)
            collects.kill()
            collects = parts.enter_context(fleet.part("collect2", "collect"))
            shows.kill()
            shows = parts.enter_context(fleet.server("serve2"))
            third = parts.enter_context(fleet.part("worker3", "work"))
            await playing
            assert rig.lost == 0
            await fleet.said("serve2", "results served", shows)
            await fleet.until_all_is_shown(scenario.samples)
            await check_bits(fleet, scenario)
            await check_a_command(fleet)
        for process, name in ((second, "worker2"), (third, "worker3"), (collects, "collect2")):
            assert process.returncode == 0, fleet.log(name).read_text()
        assert shows.returncode == 0, fleet.log("serve2").read_text()


async def check_a_command(fleet):
    """A demand is answered when a worker has it, and one estimator forgets when it is told to."""
    name = valve_names(fleet.scenario)[-1]
    async with fleet.client() as client:
        for last, number in (("PressureDrop", 80.0), ("FlowDemand", 40.0)):
            value = ua.DataValue(ua.Variant(number, ua.VariantType.Double))
            await node(client, f"{name}.Inverse.{last}").write_value(value)
        required = node(client, f"{name}.Inverse.RequiredU")
        async with asyncio.timeout(60.0):
            while not np.isfinite(await shown_value(required) or np.nan):  # noqa: ASYNC110
                await asyncio.sleep(0.2)
        await node(client, f"{name}.RLS").call_method(ua.NodeId(f"{name}.RLS.Reset", 1))
        async with asyncio.timeout(60.0):
            while await shown_value(node(client, f"{name}.RLS.SampleCount")):  # noqa: ASYNC110
                await asyncio.sleep(0.2)


async def shown_value(of):
    return (await of.read_data_value(raise_on_bad_status=False)).Value.Value


async def test_a_fleet_comes_to_one_machines_bits_whoever_is_killed(kafka, tmp_path):
    """Six valves in three groups; a worker, the collector and the results server are killed."""
    await trial(kafka, tmp_path, scenario_of(6, 20.0, 50.0), 2, 3, second_s=1.0)


@pytest.mark.soak
async def test_four_hundred_valves_come_to_one_machines_bits_whoever_is_killed(kafka, tmp_path):
    await trial(kafka, tmp_path, scenario_of(400, 120.0, 20.0), 50, 4, second_s=8.0)
