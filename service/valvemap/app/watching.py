"""Observes signals at a source: their timing, values and noise; checks a configuration online."""

import asyncio
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from valvemap.app.connections import build_axis_sources, build_source
from valvemap.clock import SystemClock
from valvemap.config.models import Config
from valvemap.config.valve_parts import EdgeConfig, LineConfig
from valvemap.errors import SourceRejected
from valvemap.opcua_source.client import OpcUaSource
from valvemap.pipeline.data_changes import DataChanges
from valvemap.vocabulary.signals import MEASURED, PER_VALVE, Signal

FEW = 5  # values; a signal with fewer is treated as on change
UNSTEADY = 5.0  # ratio of long to short intervals; a larger one means not cyclic


@dataclass(frozen=True)
class Watched:
    """The observed statistics of one signal.

    ``rate_hz`` values per second, ``skew_ms`` distance from the valve's fastest signal (98 %
    quantile), ``on_change`` if it is not cyclic, ``good`` the share of Good values, ``mean`` and
    ``noise`` in our units, ``longest_s`` the longest interval.
    """

    values: int
    rate_hz: float
    skew_ms: float
    on_change: bool
    good: float
    mean: float
    noise: float
    longest_s: float


async def check_online(config: Config, watch_s: float) -> list[str]:
    """Connect as `serve` would, monitor every signal, and return a line of statistics for each.

    A node that several valves or edges read has one line, with its largest skew.

    Raises
    ------
    SourceLost, SourceRejected
        also if a signal sent no Good value; names signal, node and valve.
    """
    await build_axis_sources(config).check()
    lines = [f"{axis.name}: every node is there, in its unit" for axis in config.axes]
    if not config.valves:
        return lines
    changes = await changes_of(build_source(config), watch_s)
    silent: dict[str, str] = {}
    of_node: dict[str, list[tuple[str, str, Watched]]] = {}
    advice: dict[str, None] = {}
    for number, valve in enumerate(config.valves):
        sources = {role: valve.nodes.source_of(role) for role in MEASURED}
        nodes = {
            role: node
            for role, name in sources.items()
            if (node := valve.nodes.of(name)) is not None
        }
        for role, seen in seen_of(changes, number, nodes, watch_s).items():
            whose, name = valve.name, sources[role]
            if isinstance(valve, EdgeConfig | LineConfig):
                whose, name = valve.valve, valve.called.get(name, name)
            of_node.setdefault(nodes[role], []).append((f"{whose}.{name}", role, seen))
            if seen.good == 0.0:
                silent[nodes[role]] = f"{name} of valve {whose} (node '{nodes[role]}')"
            advice |= dict.fromkeys(_advice(config, f"{whose}.{name}", role, seen))
    if silent:
        raise SourceRejected(
            f"{config.source.url}: nothing good came in {watch_s:g} s from "
            f"{', '.join(silent.values())}; is it the right node, and is it written?"
        )
    return [*lines, *map(_line, of_node.values()), *advice]


def _line(readers: Sequence[tuple[str, str, Watched]]) -> str:
    """Describe a node by the statistics of the reader with the largest skew."""
    names = list(dict.fromkeys(name for name, _, _ in readers))
    also = f" (also {', '.join(names[1:])})" if len(names) > 1 else ""
    _, role, seen = max(readers, key=lambda reader: reader[2].skew_ms)
    comes, unit = "on change" if seen.on_change else "cyclic", Signal.of(role).unit
    return (
        f"{names[0]}{also}: {seen.rate_hz:.3g} Hz, {comes}, skew {seen.skew_ms:.3g} ms, "
        f"{100 * seen.good:.0f} % good, mean {seen.mean:.4g} {unit}, noise {seen.noise:.2g} {unit}"
    )


def _advice(config: Config, name: str, role: str, seen: Watched) -> Iterator[str]:
    """Yield the settings that the observed timing of a signal requires."""
    if config.alignment.finds_timing:
        return
    held = {str(name): s for name, s in config.alignment.hold_s.items()}.get(role, 0.0)
    if seen.on_change and held < seen.longest_s:
        yield (
            f"{name}: hint: it comes on change, {seen.longest_s:.1f} s apart: "
            f"alignment.hold_s = {{ {role} = {max(10.0, 5 * seen.longest_s):.0f} }}"
        )
    elif not seen.on_change and seen.skew_ms > config.alignment.tolerance_ms:
        yield (
            f"{name}: hint: it is stamped {seen.skew_ms:.3g} ms beside the others: "
            f"alignment.tolerance_ms = {np.ceil(2 * seen.skew_ms):.0f}"
        )


async def changes_of(source: OpcUaSource, watch_s: float) -> DataChanges:
    """Return all data changes that a source sends within ``watch_s``."""
    clock, parts = SystemClock(), list[DataChanges]()
    await source.connect()
    try:
        ends = clock.monotonic() + watch_s
        while (left := ends - clock.monotonic()) > 0.0:
            try:
                async with asyncio.timeout(left):
                    parts.append(await source.receive())
            except TimeoutError:
                break
    finally:
        await source.close()
    return DataChanges.concatenate(parts)


def seen_of(
    changes: DataChanges, number: int, roles: Collection[str], watch_s: float
) -> dict[str, Watched]:
    """Return the statistics of one valve's signals, by role."""
    of_signal = {
        role: changes[changes.item == number * PER_VALVE + place]
        for place, role in enumerate(MEASURED)
        if role in roles
    }
    clock_signal = max(of_signal.values(), key=len)
    return {role: seen_beside(own, clock_signal, watch_s) for role, own in of_signal.items()}


def seen_beside(own: DataChanges, others: DataChanges, watch_s: float) -> Watched:
    """Return the statistics of a signal, with its skew to the most frequent one of its valve."""
    steps = np.diff(np.unique(own.source_time)) * 1e-9
    short, long = np.quantile(steps, [0.1, 0.9]) if len(steps) else (0.0, 0.0)
    seldom = len(own) < 0.5 * len(others)
    good = own.value[(own.status >> 30 == 0) & np.isfinite(own.value)]
    second = np.diff(good, n=2)
    return Watched(
        values=len(own),
        rate_hz=len(own) / watch_s,
        skew_ms=_skew_ms(own.source_time, others.source_time),
        on_change=bool(len(own) < FEW or seldom or long > UNSTEADY * short),
        good=len(good) / max(len(own), 1),
        mean=float(good.mean()) if len(good) else np.nan,
        noise=float(np.median(np.abs(second)) / (0.6745 * 6.0**0.5)) if len(second) else np.nan,
        longest_s=float(steps.max()) if len(steps) else watch_s,
    )


def _skew_ms(times: np.ndarray, others: np.ndarray) -> float:
    """Return the distance to the nearest value of another signal, 98 % quantile, ms."""
    if not len(times) or not len(others):
        return 0.0
    ordered = np.sort(others)
    right = np.clip(np.searchsorted(ordered, times), 0, len(ordered) - 1)
    left = np.maximum(right - 1, 0)
    distance = np.minimum(np.abs(ordered[right] - times), np.abs(times - ordered[left]))
    return float(np.quantile(distance, 0.98)) * 1e-6
