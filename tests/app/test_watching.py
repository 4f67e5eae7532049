"""`check-config --online` has one line for each node, with the unit of its numbers."""

import numpy as np

from valvemap.app import watching
from valvemap.config.models import Config
from valvemap.pipeline.data_changes import DataChanges
from valvemap.vocabulary.signals import PER_VALVE

PORTS = {name: f"ns=2;s=Boom.{name}" for name in ("U", "pP", "pT", "pA", "pB", "QA", "QB")}
N = 50


async def lines_of(config, late, monkeypatch):
    """Each signal of each valve comes every 20 ms, p1 of the valve ``late`` 7 ms later."""
    item = np.repeat(np.arange(len(config.valves) * PER_VALVE), N)
    t = 20_000_000 * np.tile(np.arange(1, N + 1), len(config.valves) * PER_VALVE)
    t += 7_000_000 * ((item // PER_VALVE == late) & (item % PER_VALVE == 1))
    good = np.zeros(len(item), np.uint32)
    changes = DataChanges(item=item, value=np.sin(t * 1e-9), status=good, source_time=t)

    async def changes_of(_source, _watch_s):
        return changes

    monkeypatch.setattr(watching, "changes_of", changes_of)
    return await watching.check_online(config, 1.0)


async def test_a_node_that_several_edges_read_has_one_line(monkeypatch):
    config = Config(valves=[{"name": "Boom", "ports": PORTS}])
    late = [valve.name for valve in config.valves].index("Boom.PA")
    lines = await lines_of(config, late, monkeypatch)
    assert {line.partition(":")[0] for line in lines} == {f"Boom.{name}" for name in PORTS}
    assert len(lines) == len(PORTS)
    (pP,) = [line for line in lines if line.startswith("Boom.pP")]
    assert ": 50 Hz, cyclic, skew 7 ms, 100 % good, mean" in pP
    assert pP.count(" bar") == 2


async def test_valves_that_share_a_node_are_named(monkeypatch):
    nodes = {name: f"ns=2;s={name}" for name in ("U", "p1", "p2", "Q")}
    other = nodes | {"U": "ns=2;s=U2", "p2": "ns=2;s=p22", "Q": "ns=2;s=Q2"}
    config = Config(valves=[{"name": "V1", "nodes": nodes}, {"name": "V2", "nodes": other}])
    lines = await lines_of(config, 0, monkeypatch)
    assert len(lines) == 7
    assert any(line.startswith("V1.p1 (also V2.p1): 50 Hz, cyclic, skew 7 ms") for line in lines)
