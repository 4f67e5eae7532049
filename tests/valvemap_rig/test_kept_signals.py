"""What the rig remembers of its samples."""

import asyncio
import datetime as dt

import numpy as np
import pytest
from asyncua import ua

from guarded_opcua import ServerSettings, Span, Variable
from support.served import patient
from support.stream import until
from valvemap_rig.history import Ring
from valvemap_rig.scenario import BUILTIN
from valvemap_rig.server import RigServer

EVER = Span(-(2**63), 2**63 - 1)
A, B = (Variable(ua.NodeId(name, 2), ua.VariantType.Double) for name in "AB")


def ring_of(length, samples, piece):
    """A ring that took ``samples`` (values, times, codes, present) in pieces."""
    ring = Ring([A, B], length, np.float64)
    for k in range(0, len(samples[0]), piece):
        values, t, codes, present = (column[k : k + piece] for column in samples)
        ring.keep(values, t, 5, codes, present)
    return ring


def made_up(n, seed=1, *, steps_back=False):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.integers(-2 if steps_back else 0, 5, (n, 2)) * 100, axis=0)
    codes = np.where(rng.random((n, 2)) < 0.2, 0x8000_0000, 0).astype(np.uint32)
    return rng.normal(size=(n, 2)), t, codes, rng.random((n, 2)) < 0.8


@pytest.mark.parametrize("piece", [1, 3, 7, 40])
@pytest.mark.parametrize("steps_back", [False, True])
def test_a_ring_answers_like_a_list_of_its_last_samples(piece, steps_back):
    samples = made_up(100, steps_back=steps_back)
    ring = ring_of(40, samples, piece)
    rng = np.random.default_rng(2)
    for column, variable in enumerate((A, B)):
        kept = [
            (int(t[column]), values[column], int(codes[column]))
            for values, t, codes, there in list(zip(*samples, strict=True))[-40:]
            if there[column]
        ]
        for _ in range(30):
            low, high = sorted(int(x) for x in rng.choice(samples[1][:, column], 2))
            back, skip, most = bool(rng.integers(2)), int(rng.integers(4)), int(rng.integers(1, 20))
            wanted = sorted((r for r in kept if low <= r[0] <= high), key=lambda r: r[0])
            wanted = (wanted[::-1] if back else wanted)[skip : skip + most]
            found = ring.raw(variable.id, Span(low, high, backwards=back), skip, most)
            assert list(zip(found.source, found.values, found.codes, strict=True)) == wanted


def test_a_ring_that_is_not_full_yet_knows_what_came():
    ring = ring_of(40, made_up(0), 1)
    assert len(ring.raw(A.id, EVER, 0, 10)) == 0
    values, t, codes, _ = made_up(3)
    ring.keep(values, t, 5, codes)
    assert ring.raw(A.id, EVER, 0, 10).values.tolist() == values[:, 0].tolist()


async def test_a_rig_tells_again_what_it_said(tmp_path):
    blocks = []
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/valvemap/rig/",
        application_uri="urn:valvemap:rig",
        application_name="valvemap rig",
        namespace_uri="urn:valvemap:rig",
        none_on_loopback=True,
    )
    scenario = BUILTIN["scattered"].model_copy(update={"duration_s": 0.5, "history_s": 0.3})
    rig = await RigServer.create(settings, scenario, on_block=blocks.append)
    async with rig, patient(rig.url) as client:
        playing = asyncio.create_task(rig.run())
        await until(lambda: rig.samples == 50)
        playing.cancel()
        index = await client.get_namespace_index("urn:valvemap:rig")
        read = {}
        for name in ("U", "Q", "Sequence"):
            node = client.get_node(ua.NodeId(f"Valvistor.{name}", index))
            found = await node.read_raw_history(
                blocks_start(blocks), None, 1000, return_bounds=False
            )
            read[name] = [value.Value.Value for value in found]
    valve = [block.valves["Valvistor"] for block in blocks]
    for name in ("U", "Q"):
        said = np.concatenate([getattr(block, name) for block in valve])
        assert read[name] == said[-30:].tolist()
    assert read["Sequence"] == list(range(20, 50))


def blocks_start(blocks):
    return dt.datetime.fromtimestamp(0, dt.UTC) + dt.timedelta(
        microseconds=int(blocks[0].t[0]) // 1000
    )
