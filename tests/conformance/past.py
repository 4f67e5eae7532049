"""A known past, and its aggregates by formulas of their own, for clients of other stacks."""

from contextlib import asynccontextmanager
from dataclasses import dataclass

import numpy as np
from asyncua import ua

from guarded_opcua import (
    HardenedServer,
    Records,
    ServerSettings,
    add_object,
    add_variable,
)
from guarded_opcua.history.aggregate_kinds import Aggregate

MS = 1_000_000  # ns
T0 = 1_800_000_000_000  # ms
WIDTH, INTERVALS = 1_000, 12  # ms
GOOD, BAD = 0, 0x80890000
AGGREGATES = tuple(one.name for one in Aggregate)
OF_STATUS = ("DURATION_GOOD", "DURATION_BAD", "PERCENT_GOOD", "PERCENT_BAD")
OWN_TIME = ("MINIMUM_ACTUAL_TIME", "MAXIMUM_ACTUAL_TIME", "START", "END")
OF_VALUES = {
    "AVERAGE": lambda v: v.sum() / len(v),
    "COUNT": len,
    "MINIMUM": min,
    "MAXIMUM": max,
    "MINIMUM_ACTUAL_TIME": min,
    "MAXIMUM_ACTUAL_TIME": max,
    "RANGE": lambda v: max(v) - min(v),
    "START": lambda v: v[0],
    "END": lambda v: v[-1],
    "DELTA": lambda v: v[-1] - v[0],
    "STANDARD_DEVIATION_SAMPLE": lambda v: np.std(v, ddof=1),
    "STANDARD_DEVIATION_POPULATION": np.std,
    "VARIANCE_SAMPLE": lambda v: np.var(v, ddof=1),
    "VARIANCE_POPULATION": np.var,
}


@dataclass(frozen=True)
class Past:
    """Times (ms since T0), values and status codes of a variable, and the node of each past."""

    t: np.ndarray
    values: np.ndarray
    codes: np.ndarray
    nodes: dict

    def asked(self, name):
        """The request of an aggregate: status from the doubtful past, values from the good one."""
        return {
            "node": self.nodes[name in OF_STATUS],
            "aggregate": f"i={int(Aggregate[name])}",
            "start": T0,
            "end": T0 + INTERVALS * WIDTH,
            "interval": float(WIDTH),
        }

    def expected(self, name):
        """Time (ms since T0) and value of each interval."""
        for k in range(INTERVALS):
            low, high = k * WIDTH, (k + 1) * WIDTH
            inside = (self.t >= low) & (self.t < high)
            t, v = self.t[inside], self.values[inside]
            at = {"MINIMUM_ACTUAL_TIME": v.argmin(), "MAXIMUM_ACTUAL_TIME": v.argmax()}
            at |= {"START": 0, "END": -1}
            time = t[at[name]] if name in OWN_TIME else low
            yield int(time), float(self._value(name, v, low, high))

    def _value(self, name, v, low, high):
        if name in OF_VALUES:
            return OF_VALUES[name](v)
        match name:
            case "INTERPOLATIVE":
                return np.interp(low, self.t, self.values)
            case "TOTAL":
                return self._integral(low, high) * 1e-3  # of l/min over s
            case "TIME_AVERAGE":
                return self._integral(low, high) / WIDTH
        lasted = self._lasted(low, high, GOOD if name.endswith("GOOD") else BAD)
        return lasted if name.startswith("DURATION") else 100.0 * lasted / WIDTH

    def _integral(self, low, high):
        """Area below the line between the values, in their unit times ms."""
        every = np.unique(np.concatenate([self.t, [low, high]]))
        line = np.interp(every, self.t, self.values)
        inside = (every >= low) & (every <= high)
        return np.trapezoid(line[inside], every[inside])

    def _lasted(self, low, high, code):
        """Time with the status of the newest value, ms."""
        return sum(
            self.codes[np.searchsorted(self.t, moment, side="right") - 1] == code
            for moment in range(low, high)
        )


def made(nodes):
    """Some values in each interval, none at its start, no two of them equal; some are Bad."""
    rng = np.random.default_rng(42)
    ms = [
        k * WIDTH + np.sort(rng.choice(np.arange(1, WIDTH - 1), rng.integers(3, 8), replace=False))
        for k in range(-1, INTERVALS + 1)
    ]
    t = np.concatenate(ms)
    return Past(t, rng.permutation(len(t)) / 8.0, rng.choice([GOOD, GOOD, BAD], len(t)), nodes)


class Kept:
    """Implements the historian's port for both variables."""

    def __init__(self, past, doubtful):
        codes = past.codes if doubtful else np.zeros(len(past.t))
        t = (T0 + past.t) * MS
        self.kept = Records(past.values, codes.astype(np.uint32), t, t)

    def raw(self, _variable, span, skip, most):
        rows = np.flatnonzero((self.kept.source >= span.low) & (self.kept.source <= span.high))
        rows = (rows[::-1] if span.backwards else rows)[skip : skip + most]
        return Records(*(x[rows] for x in vars(self.kept).values()))


@asynccontextmanager
async def past_server():
    """A server with that past, good and doubtful; its address and the past."""
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/past/",
        application_uri="urn:test:past",
        application_name="past",
        namespace_uri="urn:past",
        none_on_loopback=True,
    )
    server = await HardenedServer.create(settings)
    folder = await add_object(server, None, "Plant")
    nodes, past = {}, made({})
    for doubtful in (False, True):
        node = await add_variable(server, folder, f"Plant.Flow{doubtful:d}", 0.0)
        server.add_history([node], Kept(past, doubtful))
        nodes[doubtful] = node.id.to_string()
    past.nodes.update(nodes)
    async with server:
        yield server.url, past


def disagreement(name, past, found):
    """Return how an answer differs from the formulas, None if it does not."""
    if found["code"] != ua.StatusCodes.Good or len(found["values"]) != INTERVALS:
        return f"{name}: {len(found['values'])} values, code {found['code']:#x}"
    for (t, value), shown in zip(past.expected(name), found["values"], strict=True):
        if shown["code"] >> 30 or shown["time"] != T0 + t:
            return f"{name}: {shown}, expected at {T0 + t}"
        if not np.isclose(float(shown["value"]), value, rtol=1e-12, atol=1e-12):
            return f"{name}: {shown['value']} at {t} ms, expected {value}"
    return None
