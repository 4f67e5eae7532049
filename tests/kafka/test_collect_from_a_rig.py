"""A rig on OPC UA, a collector that is killed, a real Apache Kafka."""

import asyncio

import numpy as np
import pytest

from support.broker import artifacts, brokers
from support.fleet_rig import played, rig_of, scenario_of, site_file
from support.processes import free_port, run, running, wait_for

pytest.importorskip("confluent_kafka")

from support.kafka import everything, until
from valvemap.kafka.blocks import read_samples
from valvemap.kafka.spool import Spool
from valvemap.model.samples import Samples

pytestmark = [pytest.mark.broker, pytest.mark.timeout(600)]


def write(folder, broker, spool_mb=1_000):
    file = folder / "fleet.toml"
    file.write_text(
        f"[broker]\naddresses = ['{broker}']\ntimeout_s = 3\n"
        "[topics]\nprefix = 'c'\npartitions = 3\nreplication = 1\n"
        "[catalogue]\nvalves_per_group = 2\nsites = { north = 'north.toml' }\n"
        f"[collect]\nspool = '{folder / 'spool'}'\nmost_mb = {spool_mb}\n",
        encoding="utf-8",
    )
    return file


def collected(broker):
    """Samples of each valve, each block once."""
    blocks = {}
    for message in everything(broker, "c.samples"):
        block = read_samples(message.value())
        key = block.group, block.number
        assert blocks.setdefault(key, message.value()) == message.value()
    for group, number in blocks:
        assert number == 1 or (group, number - 1) in blocks
    found = {}
    for _, packed in sorted(blocks.items()):
        block = read_samples(packed)
        for member, samples in block.samples.items():
            found.setdefault(block.valves[member], []).append(samples)
    return {name: Samples.concatenate(parts) for name, parts in found.items()}


@pytest.fixture
def node(request, tmp_path):
    jars = artifacts(request.config.cache.mkdir("kafka"))
    with brokers(jars, tmp_path / "kafka") as (node,):
        yield node


async def test_killed_collectors_and_a_broker_that_is_away_cost_no_sample(node, tmp_path):
    """The collector is killed twice, the second time while the broker is away."""
    broker = f"127.0.0.1:{node.port}"
    scenario = scenario_of(5, 14.0, 50.0)
    file = write(tmp_path, broker)
    async with await rig_of(scenario, tmp_path) as rig:
        site_file(tmp_path / "north.toml", scenario, rig.url)
        assert run("fleet", "topics", "-c", str(file)).returncode == 0

        def collector(n):
            log = tmp_path / f"collect{n}.log"
            return running("fleet", "collect", "-c", str(file), log=log), log

        async def connected(n, process):
            log = tmp_path / f"collect{n}.log"
            await asyncio.to_thread(wait_for, log, "source connected", process)

        with collector(1)[0] as first:
            await connected(1, first)
            playing = asyncio.create_task(rig.run())
            await asyncio.sleep(3.0)
            first.kill()
            with collector(2)[0] as second:
                await connected(2, second)
                await asyncio.sleep(1.0)
                node.kill()
                await asyncio.sleep(1.0)
                second.kill()
                with collector(3)[0] as third:
                    await connected(3, third)
                    await playing
                    said = tmp_path / "collect3.log"
                    await asyncio.to_thread(wait_for, said, "broker cannot be reached", third)
                    node.start()
                    await asyncio.to_thread(node.wait)
                    expected = scenario.samples

                    def all_there():
                        found = collected(broker)
                        return len(found) == 5 and min(map(len, found.values())) >= expected

                    await asyncio.to_thread(until, all_there, 120.0)
        assert third.returncode == 0, said.read_text()
        assert rig.lost == 0
    found = collected(broker)
    for name, samples in played(scenario, next(iter(found.values())).t).items():
        for signal, values in vars(samples).items():
            np.testing.assert_array_equal(getattr(found[name], signal), values, err_msg=signal)
    warnings = [line for line in said.read_text().splitlines() if "warning" in line]
    assert len([line for line in warnings if "broker" in line]) == 1, warnings


def test_a_spool_that_is_full_gives_up_the_oldest_and_says_how_much(tmp_path):
    """No broker at all, and room for little."""

    async def trial():
        scenario = scenario_of(40, 9.0, 100.0)  # 1.5 MB
        file = write(tmp_path, f"127.0.0.1:{free_port()}", spool_mb=1)
        log = tmp_path / "collect.log"
        async with await rig_of(scenario, tmp_path) as rig:
            site_file(tmp_path / "north.toml", scenario, rig.url)
            with running("fleet", "collect", "-c", str(file), log=log) as process:
                await asyncio.to_thread(wait_for, log, "source connected", process)
                await rig.run()
                await asyncio.to_thread(wait_for, log, "oldest samples are given up", process)
                await asyncio.sleep(1.0)
            assert process.returncode == 0, log.read_text()
        return log.read_text().splitlines()

    said = asyncio.run(trial())
    warnings = [line for line in said if "warning" in line]
    assert len(warnings) == 2, warnings  # the broker, and the spool: each once
    with Spool(tmp_path / "spool" / "north.sqlite", 10_000_000) as spool:
        assert spool.bytes <= 1_000_000
        kept = spool.kept()
        blocks = [read_samples(one.data) for one in spool.take(10_000_000)]
    assert b'"given_up": 0' not in kept["numbers"]
    newest = max(block.samples.samples.t.max() for block in blocks)
    oldest = min(block.samples.samples.t.min() for block in blocks)
    assert newest - oldest < 5.9e9


def test_a_topic_that_is_missing_ends_a_collector_with_one_line(node, tmp_path):
    broker = f"127.0.0.1:{node.port}"
    file = write(tmp_path, broker)
    url = f"opc.tcp://127.0.0.1:{free_port()}/nobody/"
    site_file(tmp_path / "north.toml", scenario_of(1, 1.0), url)
    (tmp_path / "rig-password").write_text("nobody asks", encoding="utf-8")
    ended = run("fleet", "collect", "-c", str(file))
    assert ended.returncode == 1
    assert (
        ended.stderr.splitlines()[-1]
        == "valvemap: c.samples: no such topic; `valvemap fleet topics` makes it"
    )
