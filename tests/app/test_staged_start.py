"""The first start in a clone: results at once, progress in words, and an end at any moment."""

import asyncio
import signal
from pathlib import Path

import pytest
from asyncua import ua

from support.processes import free_port, is_open, rig_url, running, service_url, wait_for
from support.served import patient

pytestmark = pytest.mark.waits


@pytest.fixture
def demo(tmp_path):
    """A demo whose kernels are not compiled."""
    log, rig, service = tmp_path / "demo.log", free_port(), free_port()
    env = {
        "VALVEMAP_SOURCE__URL": rig_url(rig),
        "VALVEMAP_SERVER__URL": service_url(service),
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
    }
    with running("demo", env=env, log=log) as process:
        wait_for(log, "first start", process)
        yield process, service_url(service)
    assert not is_open(rig), "the rig outlived the demo"


def descendants(pid):
    """Every process that a process started, as far as Linux tells."""
    found = []
    for listed in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, listed.read_text().split()):
            found += [child, *descendants(child)]
    return found


def runs(pid):
    """Whether a process runs: a zombie, which its parent has not awaited, does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


async def test_quick_estimators_publish_while_the_others_wait_and_sigterm_ends_all(demo):
    process, url = demo
    async with patient(url) as client:
        index = await client.get_namespace_index("urn:valvemap:service")

        async def read(name):
            node = client.get_node(ua.NodeId(name, index))
            return (await node.read_data_value(raise_on_bad_status=False)).Value.Value

        async with asyncio.timeout(60):
            while await read("Valvistor.RBF.SampleCount") < 100:  # noqa: ASYNC110 - polls results
                await asyncio.sleep(0.1)
        assert await read("Valvistor.Auto.SampleCount") == 0
        assert (await read("Service.Start.Text")).startswith("compiling: ")
        assert await read("Service.Start.Compiled") < 100.0
    started = descendants(process.pid)
    process.send_signal(signal.SIGTERM)
    assert await asyncio.to_thread(process.wait, 90) == 0
    async with asyncio.timeout(5):
        while any(map(runs, started)):  # noqa: ASYNC110 - those of another process
            await asyncio.sleep(0.05)
