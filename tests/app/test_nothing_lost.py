"""Nothing is lost on the way from the rig's sensors to the estimators, at default settings."""

import asyncio
from pathlib import Path

import pytest

from support.processes import rig_url
from valvemap.app.build import build_identification
from valvemap.app.serve import serve

pytestmark = pytest.mark.waits

RATE_HZ = 100


@pytest.mark.parametrize(
    "seconds",
    [
        pytest.param(10, id="10 s"),
        pytest.param(600, id="10 min", marks=[pytest.mark.soak, pytest.mark.timeout(900)]),
    ],
)
async def test_at_100_hz_every_sample_arrives(config, open_server, start_rig, seconds):
    port = int(config.source.url.split(":")[2].split("/")[0])
    assert config.source.url == rig_url(port)
    identification = build_identification(config)
    stop, count, early_rss = asyncio.Event(), 0, 0

    def tally(_valve, samples):
        nonlocal count, early_rss
        count += len(samples)
        if count > RATE_HZ * seconds / 4:
            early_rss = early_rss or resident_bytes()

    with start_rig(port, "--scenario", "structured"):
        serving = asyncio.ensure_future(serve(config, stop, open_server, identification, tally))
        async with asyncio.timeout(60 + 2 * seconds):
            while count < RATE_HZ * seconds and not serving.done():  # noqa: ASYNC110
                await asyncio.sleep(0.1)
        late_rss = resident_bytes()
        stop.set()
        await serving
    counters = identification.results.counters(0)
    lost = ("gaps", "missing", "late", "bad_status", "not_finite", "clock_steps")
    assert {name: counters[name] for name in lost} == dict.fromkeys(lost, 0)
    assert counters["aligned"] == count
    if seconds >= 600:
        assert late_rss < 1.05 * early_rss


def resident_bytes():
    """Memory of this process, where the system tells it."""
    statm = Path("/proc/self/statm")
    return int(statm.read_text().split()[1]) * 4096 if statm.exists() else 0
