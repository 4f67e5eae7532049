"""The configuration that `connect` writes: source, observed timing, valves."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from valvemap.app.connect import Found
from valvemap.app.dp_ranges import USUAL, dp_range_that_covers
from valvemap.config.estimators import default_estimators
from valvemap.config.ports import SIGNAL_OF
from valvemap.foreign_text import printable, toml_string
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_source.source_units import SaidOfNode, contradiction
from valvemap.pipeline.units import Measure, inside
from valvemap.plant.ports import NAMES, physics_of
from valvemap.plant.reading import Reading
from valvemap.plant.roles import QUANTITY, Role
from valvemap.plant.verdict import Verdict
from valvemap.vocabulary.signals import MEASURED

_OFFSET: Final = 2.0  # % of U; a sensor of a closed valve may show as much below 0
_PRESSURES: Final = (Role.P1, Role.PA, Role.PB)  # above p2, where flow does not reverse
_BOTH_WAYS: Final = tuple(
    f'{{ name = "{one.name}", kind = "{one.kind}" }}'
    for one in default_estimators()
    if one.any_U_range
)


def configuration(found: Found, settings: SourceSettings, template: str) -> str:
    """Return the configuration (TOML) of the accepted valves, based on the one of ``init``."""
    head = template.split("[alignment]", maxsplit=1)[0]
    source = _of_source(settings)
    start, end = head.index("[source]"), head.index("[server]")
    lines = [head[:start] + source + head[end:] + _of_alignment(found)]
    lines += [of_valve(verdict) for verdict in found.accepted]
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
    for verdict in found.accepted:
        own = found.watched.get(verdict.valve, {})
        nodes = {} if verdict.reading is None else verdict.reading.nodes
        for role, node in nodes.items():
            if (seen := own.get(node.node)) is not None:
                comes = "on change" if seen.on_change else f"{seen.rate_hz:.3g} Hz"
                lines.append(
                    f"#   {verdict.valve}.{role}: {comes}, {seen.skew_ms:.3g} ms beside the others"
                )
    return "\n".join([*lines, ""])


def of_valve(verdict: Verdict) -> str:
    """Return the configuration of one accepted valve."""
    reading = verdict.reading
    assert reading is not None  # noqa: S101 - it is accepted
    lines = ["[[valves]]", f"name = {toml_string(verdict.valve)}"]
    if any(_contradictions(reading)):
        lines.append("insist = true # its units differ from those that the server states")
    if not verdict.has_ports and verdict.least_U is None and _works_both_ways(reading):
        lines.append("U_range_percent = [-100.0, 100.0] # U below 0 was seen")
        lines.append(f"estimators = [{', '.join(_BOTH_WAYS)}]")
    dp_range = _dp_range(reading)
    if dp_range != (0.0, USUAL):
        lines.append(f"dp_range_bar = {list(dp_range)} # covers the pressures that were seen")
    section, names = "nodes", {role: str(role) for role in map(Role, (*MEASURED, "dp"))}
    if verdict.has_ports:
        section, names = "ports", dict(NAMES)
    lines += ["", f"[valves.{section}]"]
    for role, name in names.items():
        if role in reading.nodes:
            node = reading.nodes[role]
            shown = printable("/".join(node.path))
            lines.append(f"{name} = {toml_string(node.node)} # {shown}")
    lines += [f"# {edge}: {physics_of(edge, law)}" for edge, law in verdict.edges.items()]
    units = [line for role in reading.nodes for line in _of_unit(role, names[role], reading)]
    if units:
        lines += ["", "[valves.ports.signals]" if verdict.has_ports else "[valves.signals]", *units]
    lines += _assumed(reading)
    if verdict.least_U is not None:
        lines += ["", "[valves.gate.U]", f"low = {verdict.least_U:g} # one edge of four"]
    return "\n".join([*lines, ""])


def _works_both_ways(reading: Reading) -> bool:
    """Whether U is below 0 by more than a sensor's offset."""
    U = reading.values.get(Role.U, np.zeros(0))
    good = U[np.isfinite(U)]
    return bool(len(good)) and float(good.min()) < -_OFFSET


def _dp_range(reading: Reading) -> tuple[float, float]:
    """Range of Δp, bar: up to the highest pressure seen, below 0 where the drop reversed."""
    found = {role: values[np.isfinite(values)] for role, values in reading.values.items()}
    if (drop := found.get(Role.DP)) is not None and len(drop):
        return dp_range_that_covers(float(drop.min()), float(drop.max()))
    tops = [float(found[role].max()) for role in _PRESSURES if len(found.get(role, ()))]
    p1, p2 = (reading.values.get(role, np.zeros(0)) for role in (Role.P1, Role.P2))
    drop = p1 - p2 if len(p1) == len(p2) else np.zeros(0)
    drop = drop[np.isfinite(drop)]
    return dp_range_that_covers(float(drop.min(initial=0.0)), max(tops, default=0.0))


def _of_unit(role: Role, name: str, reading: Reading) -> Iterator[str]:
    measure = reading.scales[role].measure
    unit = measure.unit
    own = unit is None or unit == inside(QUANTITY[role])
    shown = "" if own or unit is None else f"unit = {toml_string(unit.symbol)}"
    if measure.raw is not None:
        raw, scaled = list(measure.raw), list(measure.scaled or ())
        more = f", {shown}" if shown else ""
        yield f"{name} = {{ raw = {raw}, range = {scaled}{more} }}"
    elif shown:
        yield f"{name} = {{ {shown} }}"


def _contradictions(reading: Reading) -> Iterator[str]:
    for role, node in reading.nodes.items():
        measure = reading.scales[role].measure
        if measure.raw is None and measure.unit == inside(QUANTITY[role]):
            measure = Measure()
        said = SaidOfNode(node.unit, node.symbol, node.bounds)
        name = SIGNAL_OF[NAMES[role]] if role in {Role.PA, Role.PB, Role.QB} else role
        fault = contradiction(name, measure, said)
        if fault is not None:
            yield fault


def _assumed(reading: Reading) -> list[str]:
    """Return comments on the units that nothing states."""
    taken = [f"{role} in {reading.scales[role].text or '%'}" for role in reading.assumed]
    return [f"# nothing states the unit of {', '.join(taken)}"] if taken else []
