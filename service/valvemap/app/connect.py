"""Creates a configuration from a foreign server: browse, propose, monitor, write."""

import asyncio
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from valvemap.app.connections import build_source
from valvemap.clock import SystemClock
from valvemap.config.models import Config
from valvemap.errors import ConfigurationError, SourceRejected
from valvemap.foreign_text import LINE, printable, toml_string
from valvemap.opcua_client.connection import open_connection
from valvemap.opcua_source.browsing import find_numbers
from valvemap.opcua_source.client import OpcUaSource, SourceSettings, ValveNodes
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.naming import Candidate, ValveProposal, propose
from valvemap.pipeline.units import QUANTITY_OF, Measure, Quantity, inside
from valvemap.vocabulary.signals import MEASURED, PER_VALVE

CLEAR_DP = 2.0  # bar; smallest mean difference that distinguishes p1 from p2
FEW = 5  # values; a signal with fewer is treated as on change
UNSTEADY = 5.0  # ratio of long to short intervals; a larger one means not cyclic
_ELECTRICAL_SPANS = {"mA": (4.0, 20.0), "V": (0.0, 10.0)}


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


@dataclass(frozen=True)
class Found:
    """Valves with their nodes, observations, and open questions.

    ``skipped`` names the nodes and valves that cannot be used, each with the reason.
    """

    valves: tuple[ValveProposal, ...]
    watched: Mapping[str, Mapping[str, Watched]]
    skipped: tuple[str, ...] = ()

    @property
    def questions(self) -> tuple[str, ...]:
        """The open decisions, one line each."""
        return tuple(f"{valve.name}.{text}" for valve in self.valves for text in valve.open)


async def look_around(settings: SourceSettings, watch_s: float) -> Found:
    """Browse a server, propose its valves, and monitor their signals for ``watch_s``.

    Raises
    ------
    SourceLost, SourceRejected
    """
    connection = await open_connection(settings)
    try:
        numbers, skipped = await find_numbers(connection)
    finally:
        await connection.close()
    valves = propose(numbers)
    whole = [valve for valve in valves if not valve.missing]
    watched, refused = await _watch(settings, whole, watch_s)
    settled = [
        _settled(valve, watched.get(valve.name, {}))
        for valve in valves
        if valve.name not in refused
    ]
    return Found(tuple(settled), watched, (*skipped, *refused.values()))


async def check_online(config: Config, watch_s: float) -> list[str]:
    """Connect as `serve` would, monitor every signal, and return a line of statistics for each.

    Raises
    ------
    SourceLost, SourceRejected
        also if a signal sent no Good value; names signal, node and valve.
    """
    changes = await _changes(build_source(config), watch_s)
    lines: list[str] = []
    silent: list[str] = []
    for number, valve in enumerate(config.valves):
        nodes = {
            role: node for role in MEASURED if (node := getattr(valve.nodes, role)) is not None
        }
        for role, seen in _seen_of(changes, number, nodes, watch_s).items():
            comes = "on change" if seen.on_change else "cyclic"
            lines.append(
                f"{valve.name}.{role}: {seen.rate_hz:.3g} Hz, {comes}, skew {seen.skew_ms:.3g} ms, "
                f"{100 * seen.good:.0f} % good, mean {seen.mean:.4g}, noise {seen.noise:.2g}"
            )
            if seen.good == 0.0:
                silent.append(f"{role} of valve {valve.name} (node '{nodes[role]}')")
            lines += _advice(config, valve.name, role, seen)
    if silent:
        raise SourceRejected(
            f"{config.source.url}: nothing good came in {watch_s:g} s from {', '.join(silent)}; "
            "is it the right node, and is it written?"
        )
    return lines


def _advice(config: Config, valve: str, role: str, seen: Watched) -> Iterator[str]:
    """Yield the settings that the observed timing of a signal requires."""
    if config.alignment.finds_timing:
        return
    held = {str(name): s for name, s in config.alignment.hold_s.items()}.get(role, 0.0)
    if seen.on_change and held < seen.longest_s:
        yield (
            f"{valve}.{role}: hint: it comes on change, {seen.longest_s:.1f} s apart: "
            f"alignment.hold_s = {{ {role} = {max(10.0, 5 * seen.longest_s):.0f} }}"
        )
    elif not seen.on_change and seen.skew_ms > config.alignment.tolerance_ms:
        yield (
            f"{valve}.{role}: hint: it is stamped {seen.skew_ms:.3g} ms beside the others: "
            f"alignment.tolerance_ms = {np.ceil(2 * seen.skew_ms):.0f}"
        )


def configuration(found: Found, settings: SourceSettings, template: str) -> str:
    """Return the configuration (TOML) of the valves found, based on the one of ``init``.

    Open decisions are comments in the section of their valve.
    """
    head = template.split("[alignment]", maxsplit=1)[0]
    source = _of_source(settings)
    start, end = head.index("[source]"), head.index("[server]")
    lines = [head[:start] + source + head[end:] + _of_alignment(found)]
    lines += [_of_valve(valve) for valve in found.valves]
    return "\n".join(lines)


def _of_source(settings: SourceSettings) -> str:
    lines = [
        "[source]",
        f"url = {toml_string(settings.url)}",
        f"security = {toml_string(str(settings.security))}",
        f"publishing_interval_ms = {settings.publishing_interval_ms:g}",
    ]
    if settings.user is not None:
        lines.append(f"user = {toml_string(settings.user)}")
        lines.append("# the password: VALVEMAP_SOURCE__PASSWORD, or password_file here")
    if not settings.check_host_name:
        lines.append("check_host_name = false")
    return "\n".join([*lines, "", ""])


def _of_alignment(found: Found) -> str:
    """Return the observed timing as comments; the service detects the timing at its start."""
    lines = ["[alignment]", "# how signals come is found at the start; when watched:"]
    for valve, signals in found.watched.items():
        for name, seen in signals.items():
            comes = "on change" if seen.on_change else f"{seen.rate_hz:.3g} Hz"
            lines.append(f"#   {valve}.{name}: {comes}, {seen.skew_ms:.3g} ms beside the others")
    return "\n".join([*lines, ""])


def _of_valve(valve: ValveProposal) -> str:
    lines = ["[[valves]]", f"name = {toml_string(valve.name)}", "", "[valves.nodes]"]
    for role in MEASURED:
        if role in valve.nodes:
            shown = printable("/".join(valve.nodes[role].path))
            lines.append(f"{role} = {toml_string(valve.nodes[role].node)} # {shown}")
        elif role != "T":
            lines.append(f'# {role} = "" # decide: no node was found')
    units = [line for role, node in valve.nodes.items() for line in _of_unit(role, node)]
    if units:
        lines += ["", "[valves.signals]", *units]
    lines += _assumed(valve)
    lines += [f"# decide: {printable(text, LINE)}" for text in valve.open]
    return "\n".join([*lines, ""])


def _assumed(valve: ValveProposal) -> list[str]:
    """Return comments on the units assumed where the server has none."""
    roles = without_unit(valve)
    if not roles:
        return []
    taken = ", ".join(f"{role} in {inside(QUANTITY_OF[role]).symbol}" for role in roles)
    return [
        f"# the server says no unit of {', '.join(roles)}: taken as {taken};",
        "# if not so, [valves.signals] says what is, such as",
        '#   U = { raw = [4, 20], range = [0, 100] } or p1 = { unit = "psi" }',
    ]


def _of_unit(role: str, node: Candidate) -> list[str]:
    measure = measure_of(role, node)
    if measure.raw is not None:
        raw, scaled = list(measure.raw), list(measure.scaled or ())
        return [f"{role} = {{ raw = {raw}, range = {scaled} }}"]
    if node.unit is None or measure.unit == inside(QUANTITY_OF[role]):
        return []
    return [f"{role} = {{ unit = {toml_string(node.unit.symbol)} }}"]


def measure_of(role: str, node: Candidate) -> Measure:
    """Return the unit of a node; a raw U is scaled from its range to 0 to 100 %."""
    unit = node.unit
    if unit is not None and unit.quantity is Quantity.ELECTRICAL:
        span = node.bounds or _ELECTRICAL_SPANS.get(unit.symbol)
        if role == "U" and span is not None:
            return Measure(raw=span, scaled=(0.0, 100.0))
        return Measure()
    if role == "U" and unit is None and node.bounds in {(4.0, 20.0), (0.0, 10.0)}:
        return Measure(raw=node.bounds, scaled=(0.0, 100.0))
    return Measure(unit=unit)


def without_unit(valve: ValveProposal) -> list[str]:
    """Return the signals of a valve for which the server has no unit."""
    nodes = valve.nodes
    return [
        role for role in MEASURED if role in nodes and measure_of(role, nodes[role]) == Measure()
    ]


async def _watch(
    settings: SourceSettings, valves: Sequence[ValveProposal], watch_s: float
) -> tuple[dict[str, dict[str, Watched]], dict[str, str]]:
    """Monitor each valve; return also the valves that the server rejects, with the reason."""
    nodes, refused = {}, {}
    for valve in valves:
        try:
            nodes[valve.name] = _nodes_of(valve)
        except ConfigurationError as error:
            refused[valve.name] = f"{valve.name}: {printable(str(error))}"
    if not nodes:
        return {}, refused
    try:
        changes = await _changes(OpcUaSource(settings, list(nodes.values())), watch_s)
    except SourceRejected:  # find the valve
        for name, own in list(nodes.items()):
            try:
                await _changes(OpcUaSource(settings, [own]), 0.0)
            except SourceRejected as error:
                refused[name] = f"{name}: {printable(str(error))}"
                del nodes[name]
        if not nodes:
            raise
        changes = await _changes(OpcUaSource(settings, list(nodes.values())), watch_s)
    roles = {valve.name: valve.nodes for valve in valves}
    seen = {
        name: _seen_of(changes, number, roles[name], watch_s) for number, name in enumerate(nodes)
    }
    return seen, refused


def _nodes_of(valve: ValveProposal) -> ValveNodes:
    return ValveNodes(
        valve=valve.name,
        **{role: node.node for role, node in valve.nodes.items()},
        measures={role: measure_of(role, node) for role, node in valve.nodes.items()},
        insist=True,
    )


async def _changes(source: OpcUaSource, watch_s: float) -> DataChanges:
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


def _seen_of(
    changes: DataChanges, number: int, roles: Collection[str], watch_s: float
) -> dict[str, Watched]:
    of_signal = {
        role: changes[changes.item == number * PER_VALVE + place]
        for place, role in enumerate(MEASURED)
        if role in roles
    }
    clock_signal = max(of_signal.values(), key=len)
    return {role: _seen(own, clock_signal, watch_s) for role, own in of_signal.items()}


def _seen(own: DataChanges, others: DataChanges, watch_s: float) -> Watched:
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


def _settled(valve: ValveProposal, seen: Mapping[str, Watched]) -> ValveProposal:
    """Assign p1 and p2 by their mean values where their names are ambiguous."""
    open_ = [text for text in valve.open if text.startswith(("p1:", "p2:"))]
    if "p1" not in seen or "p2" not in seen:
        return valve
    dp = seen["p1"].mean - seen["p2"].mean
    only_two = len(open_) == 1 and open_[0].count(" or ") == 1
    if open_ and only_two and abs(dp) > CLEAR_DP:
        nodes = dict(valve.nodes)
        if dp < 0.0:
            nodes["p1"], nodes["p2"] = nodes["p2"], nodes["p1"]
        rest = tuple(text for text in valve.open if text not in open_)
        return replace(valve, nodes=nodes, open=rest)
    if dp < -CLEAR_DP:
        said = f"p1: it lies {-dp:.3g} bar below p2; are the two swapped?"
        return replace(valve, open=(*valve.open, said))
    return valve
