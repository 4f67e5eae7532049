"""Answers to questions on the command line: ``--signal V.p1=NODE``, ``--scale V.p1=psi``."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Final

from valvemap.errors import ConfigurationError
from valvemap.pipeline.units import Measure, inside
from valvemap.plant.reading import Given
from valvemap.plant.roles import QUANTITY, Role
from valvemap.plant.scales import Scale
from valvemap.plant.unit_texts import known_unit

ROLES: Final[Mapping[str, Role]] = {name: Role(name) for name in ("U", "p1", "p2", "Q", "T", "dp")}
PORTS: Final[Mapping[str, Role]] = {
    "pP": Role.P1, "pT": Role.P2, "pA": Role.PA, "pB": Role.PB, "QA": Role.Q, "QB": Role.QB,
}  # fmt: skip
"""The signals of a valve with ports that are called otherwise than those of other valves."""
_NUMBER: Final = r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?"
_ANSWER = re.compile(
    r"(?:(?P<valve>[A-Za-z][\w-]*)\.)?(?P<role>U|p1|p2|Q|T|dp|pP|pT|pA|pB|QA|QB)=(?P<value>.+)",
    re.DOTALL,
)
_SPAN = re.compile(
    rf"({_NUMBER})\.\.({_NUMBER}):({_NUMBER})\.\.({_NUMBER})\s*(?P<unit>\S.*)?", re.DOTALL
)


def parse_answers(
    signals: Iterable[str],
    scales: Iterable[str],
    *,
    assume: bool = False,
    ports: bool = False,
) -> dict[str, Given]:
    """Return the answers by valve; those that name none are under ``""``.

    With ``ports``, signals may be those of `PORTS`; of the valve, all edges are learnt then.

    Raises
    ------
    ConfigurationError
        naming option, text and the permitted ones.

    Examples
    --------
    >>> found = parse_answers(["V1.p1=ns=2;s=A.p"], ["V1.p1=0..27648:0..250 bar"])
    >>> found["V1"].nodes[Role.P1], found["V1"].scales[Role.P1].text
    ('ns=2;s=A.p', '0..27648:0..250bar')
    >>> parse_answers(["V1.pA=ns=2;s=A.p"], [], ports=True)["V1"].ports
    True
    """
    found: dict[str, Given] = {}
    roles = {**ROLES, **PORTS} if ports else ROLES
    for option, text in (*(("--signal", s) for s in signals), *(("--scale", s) for s in scales)):
        match = _ANSWER.fullmatch(text)
        if match is None or match["role"] not in roles:
            raise ConfigurationError(
                f"{option} {text}: allowed is VALVE.SIGNAL=…, with SIGNAL one of {', '.join(roles)}"
            )
        valve, role = match["valve"] or "", roles[match["role"]]
        given = found.get(valve, Given(assume=assume))
        given = replace(given, ports=given.ports or match["role"] in PORTS)
        if option == "--signal":
            given = replace(given, nodes={**given.nodes, role: match["value"]})
        else:
            scale = _scale(text, match["value"], role)
            given = replace(given, scales={**given.scales, role: scale})
        found[valve] = given
    return found


def of_valve(given: Mapping[str, Given], valve: str, *, assume: bool = False) -> Given:
    """Return the answers for one valve, with those that name none."""
    every, own = given.get("", Given()), given.get(valve, Given())
    nodes, scales = {**every.nodes, **own.nodes}, {**every.scales, **own.scales}
    return Given(nodes, scales, assume=assume, ports=own.ports)


def _scale(answer: str, text: str, role: Role) -> Scale:
    match = _SPAN.fullmatch(text.strip())
    unit_text = text if match is None else (match["unit"] or "")
    unit = known_unit(unit_text) if unit_text.strip() else inside(QUANTITY[role])
    if unit is None or unit.quantity is not QUANTITY[role]:
        noun = QUANTITY[role].noun
        raise ConfigurationError(
            f"--scale {answer}: allowed is a unit of {noun}, such as {QUANTITY[role].value}, or "
            f"LOW..HIGH:LEAST..MOST with a unit, such as 0..27648:0..250bar"
        )
    if match is None:
        return Scale(Measure(unit=unit), 0.0, "as answered")
    low, high, least, most = (float(match[n]) for n in range(1, 5))
    if low == high:
        raise ConfigurationError(f"--scale {answer}: {low:g}..{high:g} is no span")
    own = None if unit == inside(QUANTITY[role]) else unit
    return Scale(Measure(None, own or unit, (low, high), (least, most)), 0.0, "as answered")
