"""A valve with ports for tests: its configuration, a recording, and its data changes."""

import numpy as np

from valvemap.pipeline.data_changes import DataChanges
from valvemap.vocabulary.signals import PER_VALVE, Signal

NODES = ("U", "pP", "pT", "pA", "pB", "QA", "QB", "T")
GAINS = {"PA": 0.14, "AT": 0.11, "PB": 0.10, "BT": 0.09}  # l/min/%/√bar
DROPS = {"PA": ("pP", "pA"), "AT": ("pA", "pT"), "PB": ("pP", "pB"), "BT": ("pB", "pT")}
LEAKAGE = 0.01  # l/min/bar
DEAD = 5.0  # %


def toml(estimators="RLS", more="", head="", uri="urn:plant"):
    nodes = "\n".join(f'{name} = "nsu={uri};s=V.{name}"' for name in NODES)
    kinds = "\n".join(f'[[valves.estimators]]\nkind = "{kind}"' for kind in estimators.split())
    return f'[[valves]]\nname = "V"\n{head}\n[valves.ports]\n{nodes}\n{more}\n{kinds}\n'


def flow(edge, U, dp):
    """True flow at |U|."""
    return GAINS[edge] * np.maximum(np.abs(U) - DEAD, 0.0) * np.sqrt(dp)


def recording(seconds=40.0, sigma=0.1, seed=1, rate_hz=100.0):
    """U in steps of both signs with rests, pressures that wander, both lines' flows."""
    rng = np.random.default_rng(seed)
    n = round(seconds * rate_hz)
    steps = np.repeat(rng.uniform(-100.0, 100.0, n // 40 + 1), 40)[:n]
    U = np.where(np.repeat(rng.random(n // 40 + 1) < 0.3, 40)[:n], 0.0, steps)

    def wander(low, high, period):
        middle, swing = (low + high) / 2.0, (high - low) / 2.0
        return middle + swing * np.sin(np.arange(n) / rate_hz * 2 * np.pi / period)

    found = {"t": np.arange(n) / rate_hz, "U": U}
    found |= {"pP": wander(170, 190, 7.0), "pT": wander(2, 6, 5.0)}
    found |= {"pA": wander(30, 150, 3.1), "pB": wander(30, 140, 4.3), "T": np.full(n, 40.0)}
    is_open = {"PA": U > 0.0, "AT": U < 0.0, "PB": U < 0.0, "BT": U > 0.0}
    flows = {
        edge: flow(edge, U, found[first] - found[second]) * is_open[edge]
        for edge, (first, second) in DROPS.items()
    }
    lost = LEAKAGE * (found["pA"] - found["pB"])
    found["QA"] = flows["PA"] - flows["AT"] - lost + sigma * rng.normal(size=n)
    found["QB"] = flows["PB"] - flows["BT"] + lost + sigma * rng.normal(size=n)
    return found


def changes_of(config, recorded, rows=slice(None), left_out=()):
    """The changes of all parts' nodes, sample by sample, as they arrive from a server."""
    t = np.round(recorded["t"][rows] * 1e9).astype(np.int64) + 10**18
    items, values = [], []
    for number, valve in enumerate(config.valves):
        for signal in Signal:
            node = valve.nodes.of(valve.nodes.source_of(signal.label))
            if node is None or (valve.name, signal.label) in left_out:
                continue
            items.append(number * PER_VALVE + signal)
            values.append(recorded[node.rpartition(".")[2]][rows])
    return DataChanges(
        item=np.tile(np.array(items, np.int32), len(t)),
        value=np.stack(values, axis=1).reshape(-1),
        status=np.zeros(len(t) * len(items), np.uint32),
        source_time=np.repeat(t, len(items)),
    )
