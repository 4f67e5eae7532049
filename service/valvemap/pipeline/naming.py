"""Assignment of a foreign server's variables to a valve's signals, by unit, name and path. Pure.

Plants name signals in their own language and by their own scheme: folders per valve, flat tags,
names of data blocks, KKS codes. The unit gives the quantity, the name which of two signals it is,
the path the valve. Ambiguities are reported, not guessed.
"""

import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

from valvemap.foreign_text import printable
from valvemap.pipeline.units import Quantity, Unit
from valvemap.vocabulary.signals import MEASURED, REQUIRED

_PRESSURE = "pressure press druck pression presion pressione 压力 油压 pt pi pit cp p"
_WORDS: Final[Mapping[str, str]] = {
    "U": "u cmd command setpoint sp soll sollwert stellwert stellgrosse stellgroesse stellsignal "
    "ansteuerung spannung voltage opening offnung oeffnung stellung ventilstellung position pos "
    "consigne commande ouverture consigna mando apertura comando 开度 阀位 指令 给定 阀门开度 "
    "控制信号 控制电压 co mv zt zi gt cg spool control steuersignal signal tension tensione "
    "voltaje demand valve stroke hub posizione posicion valvola y zc",
    "p": _PRESSURE,
    "Q": "q flow durchfluss volumenstrom debit caudal flujo portata 流量 ft fi fit cf "
    "flowrate rate",
    "T": "t temp temperature temperatur temperatura 温度 油温 tt ti tit ct "
    "oltemperatur oeltemperatur",
}
_BEFORE: Final = (
    "p1 supply inlet in upstream before vor vordruck zulauf eingang pump pumpe amont alimentation "
    "entree entrada alimentacion suministro ingresso mandata monte alimentazione 上游 进口 入口 "
    "阀前 供油 进油 a up antes admission pin feed versorgung pumpendruck systemdruck aguas-arriba "
    "arriba delivery ps"
)
_BEHIND: Final = (
    "p2 return outlet out downstream after behind nach hinter ruecklauf rucklauf ablauf ausgang "
    "aval retour sortie salida retorno uscita ritorno valle 下游 出口 阀后 回油 tank load last "
    "lastdruck b down despues pout abajo scarico pr"
)
_KKS = re.compile(r"\d{0,2}[A-Z]{3}\d{2}(C[PTFG])\d{3}")
_KKS_VALVE = re.compile(r"(\d{0,2}[A-Z]{3}\d{2})(?:AA|C[PTFG])\d{3}")
_OTHER: Final = (
    "alarm limit max min hh ll high low raw status state quality simulation fault error enable "
    "speed level niveau fullstand motor filter counter hours sim test"
)
_COMMANDS: Final = (
    "cmd command setpoint sp sollwert stellwert consigne consigna mando comando 指令 给定"
)
_ROLE_OF_QUANTITY: Final = {
    Quantity.OPENING: "U",
    Quantity.PRESSURE: "p",
    Quantity.FLOW: "Q",
    Quantity.TEMPERATURE: "T",
}
_KKS_ROLES: Final = {"CP": "p", "CT": "T", "CF": "Q", "CG": "U"}
_BY_UNIT, _BY_NAME, _BY_CODE = 4.0, 2.0, 3.0  # weights


@dataclass(frozen=True)
class Candidate:
    """One variable of a server: NodeId, names from the Objects folder down, and its unit."""

    node: str
    path: tuple[str, ...]
    unit: Unit | None = None
    bounds: tuple[float, float] | None = None
    writable: bool = False
    description: str = ""


@dataclass(frozen=True)
class ValveProposal:
    """The nodes of one valve; ``open`` lists the ambiguous signals and their candidate nodes."""

    name: str
    nodes: Mapping[str, Candidate]
    open: tuple[str, ...] = ()

    @property
    def missing(self) -> tuple[str, ...]:
        """Signals without a node."""
        return tuple(role for role in REQUIRED if role not in self.nodes)


@dataclass
class _Judged:
    candidate: Candidate
    role: str  # U, p, Q, T
    side: int  # of a pressure: -1 upstream, 1 downstream, 0 unknown
    weight: float
    rest: tuple[str, ...] = field(default=())


def propose(candidates: Iterable[Candidate]) -> list[ValveProposal]:
    """Find the valves of a server.

    Examples
    --------
    >>> names = ("Stellwert", "Vordruck", "Rücklauf Druck", "Durchfluss")
    >>> found = propose(Candidate(f"s={n}", ("Anlage", "Ventil 7", n)) for n in names)
    >>> found[0].name, found[0].nodes["p2"].path[-1]
    ('Ventil_7', 'Rücklauf Druck')
    """
    judged = [found for found in map(_judge, candidates) if found is not None]
    found: list[tuple[tuple[str, ...], list[_Judged]]] = []
    for place, own in _grouped(judged, _by_folder).items():
        finer = [
            parts
            for key in (_by_code, _by_number, _by_rest)
            for parts in [{k: g for k, g in _grouped(own, key).items() if _is_whole(g)}]
            if len(parts) > 1
        ]
        if finer:
            found += [((*place, *key), part) for key, part in finer[0].items()]
        elif _is_whole(own):
            found.append((place, own))
    if not found:
        return _of_all(judged)
    names = _short_names([place for place, _ in found])
    return [_proposal(names[place], own) for place, own in found]


def _of_all(judged: Sequence[_Judged]) -> list[ValveProposal]:
    """Group signals from several folders: by their numbers, else as one valve."""
    for key in (_by_code, _by_number):
        whole = {k: own for k, own in _grouped(judged, key).items() if _is_whole(own)}
        if whole:
            names = _short_names(list(whole))
            return [_proposal(names[place], own) for place, own in whole.items()]
    return [_proposal("Valve", judged)] if judged else []


def _grouped(
    judged: Iterable[_Judged], key: Callable[[_Judged], tuple[str, ...]]
) -> dict[tuple[str, ...], list[_Judged]]:
    groups: dict[tuple[str, ...], list[_Judged]] = {}
    for one in judged:
        groups.setdefault(key(one), []).append(one)
    return groups


def _judge(candidate: Candidate) -> _Judged | None:
    words, unit = _tokens(candidate.path[-1]), candidate.unit
    said = _tokens(candidate.description)
    side = _side([*words, *said]) or _numbered_side(words)
    weights = {role: _weight(role, words, said, candidate) for role in _WORDS}
    if side and not any(weights.values()) and any(len(word) > 3 for word in words):
        weights["p"] = 1.0  # "upstream" alone
    role = max(weights, key=lambda name: weights[name])
    measured = None if unit is None else _ROLE_OF_QUANTITY.get(unit.quantity)
    is_raw = unit is not None and unit.quantity is Quantity.ELECTRICAL
    if weights[role] <= 0.0 or (unit is not None and measured != role and not is_raw):
        return None
    known = {*_WORDS[role].split(), *_BEFORE.split(), *_BEHIND.split()}
    rest = tuple(word for word in words if not _match(word, known))
    return _Judged(candidate, role, side, weights[role], rest)


def _weight(role: str, words: Sequence[str], said: Sequence[str], candidate: Candidate) -> float:
    """Return the weight of the evidence for a role."""
    known, weight = set(_WORDS[role].split()), 0.0
    weight += _BY_NAME * sum(_match(word, known) for word in words)
    weight *= 1.5 if len(words) == 1 else 1.0  # the whole name
    weight += 0.25 * _BY_NAME * sum(_match(word, known) for word in said)
    unit, code = candidate.unit, _KKS.search(candidate.path[-1].upper())
    if unit is not None and _ROLE_OF_QUANTITY.get(unit.quantity) == role:
        weight += _BY_UNIT
    if code is not None and _KKS_ROLES[code[1]] == role:
        weight += _BY_CODE
    if role == "U" and weight > 0.0 and set(_COMMANDS.split()) & set(words):
        weight += 0.75
    if role == "p" and {"p1", "p2", "pa", "pb", "pin", "pout"} & set(words):
        weight += _BY_NAME
    return weight - _BY_NAME * bool(set(_OTHER.split()) & set(words))


def _numbered_side(words: Sequence[str]) -> int:
    """Side by number, as in P 1, Druck_2: a number that follows a word for pressure."""
    pressures = {*_PRESSURE.split()}
    for word, following in pairwise(words):
        if _match(word, pressures) and following in {"1", "2"}:
            return -1 if following == "1" else 1
    return 0


def _side(words: Sequence[str]) -> int:
    before = sum(_match(word, _BEFORE.split()) for word in words)
    behind = sum(_match(word, _BEHIND.split()) for word in words)
    return (behind > before) - (before > behind)


def _match(word: str, known: Collection[str]) -> float:
    """1 if a token is one of ``known``, 0.7 if it is a compound with a long one of them, else 0."""
    if word in known:
        return 1.0
    is_han = any("\u4e00" <= letter <= "\u9fff" for letter in word)
    least, at_the_end = (2, 2) if is_han else (5, 4)
    return 0.7 * any(
        (len(name) >= least and name in word) or (len(name) >= at_the_end and word.endswith(name))
        for name in known
    )


def _tokens(text: str) -> list[str]:
    """Words of a name, without case and accents; ``flowRate`` and ``PT101`` are two each.

    >>> _tokens('"DB10"."FCV-101"."Öldruck_Vor"'), _tokens("PT101a")
    (['db', '10', 'fcv', '101', 'oldruck', 'vor'], ['pt', '101', 'a'])
    """
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    plain = unicodedata.normalize("NFKD", parted.casefold().replace("ß", "ss"))
    plain = "".join(letter for letter in plain if not unicodedata.combining(letter))
    found: list[str] = []
    for word in re.findall(r"[a-z0-9]+|[\u4e00-\u9fff]+", plain):
        if re.fullmatch(r"[pqut][12]|[a-z]+|[\u4e00-\u9fff]+|\d+", word):
            found.append(word)
        else:
            found += re.findall(r"p[12](?!\d)|[a-z]+|\d+", word)
    return found


def _by_folder(judged: _Judged) -> tuple[str, ...]:
    """Group by path: the folder, or the part of a tag before its last name."""
    path = judged.candidate.path
    tag = re.split(r'"?\."?|/|\\|:', path[-1].strip('"'))
    return (*path[:-1], *tag[:-1])


def _by_code(judged: _Judged) -> tuple[str, ...]:
    """Group by the system of a KKS code."""
    match = _KKS_VALVE.search(judged.candidate.path[-1].upper())
    return ("?",) if match is None else (match[1],)


def _by_number(judged: _Judged) -> tuple[str, ...]:
    """Group by the number of the loop, as in PT-101."""
    return tuple(word for word in judged.rest if word.isdigit() and len(word) > 1)


def _by_rest(judged: _Judged) -> tuple[str, ...]:
    """Group by the words of a flat tag that do not describe the signal."""
    return judged.rest or ("",)


def _is_whole(own: Sequence[_Judged]) -> bool:
    roles = [one.role for one in own]
    return "U" in roles and "Q" in roles and roles.count("p") >= 2


def _proposal(name: str, own: Sequence[_Judged]) -> ValveProposal:
    nodes: dict[str, Candidate] = {}
    questions: list[str] = []
    for role in ("U", "Q", "T"):
        best = _best([one for one in own if one.role == role])
        if not best:
            continue
        nodes[role] = best[0].candidate
        if len(best) > 1:
            questions.append(f"{role}: {_listed(best)}")
    pressures = [one for one in own if one.role == "p"]
    for role, side in (("p1", -1), ("p2", 1)):
        best = _best([one for one in pressures if one.side == side])
        if best:
            nodes[role] = best[0].candidate
            if len(best) > 1:
                questions.append(f"{role}: {_listed(best)}")
    left = [one for one in pressures if one.candidate not in nodes.values()]
    for role in ("p1", "p2"):
        if role not in nodes and left:
            if len(left) > 1 or ("p1" in nodes and role == "p1"):
                questions.append(f"{role}: {_listed(left)}")
            nodes[role] = left.pop(0).candidate
    questions += [f"{role}: no node was found" for role in REQUIRED if role not in nodes]
    return ValveProposal(name, {r: nodes[r] for r in MEASURED if r in nodes}, tuple(questions))


def _best(own: Sequence[_Judged]) -> list[_Judged]:
    most = max((one.weight for one in own), default=0.0)
    return [one for one in own if one.weight >= most - 0.5]


def _listed(own: Sequence[_Judged]) -> str:
    return " or ".join(printable(one.candidate.node) for one in own[:4])


def _short_names(places: Sequence[tuple[str, ...]]) -> dict[tuple[str, ...], str]:
    """Return a unique name for each path: its last part, with as many before it as necessary."""
    depths = range(1, max(map(len, places)) + 1)
    at_depth = [[_name("_".join(place[-depth:])) for place in places] for depth in depths]
    for names in at_depth:
        if len(set(names)) == len(names):
            return dict(zip(places, names, strict=True))
    counts = [Counter(names) for names in at_depth]
    found: dict[tuple[str, ...], str] = {}
    taken: set[str] = set()
    for number, place in enumerate(places):
        own = (
            names[number]
            for names, n in zip(at_depth, counts, strict=True)
            if n[names[number]] == 1
        )
        name = next((name for name in own if name not in taken), f"Valve{number + 1}")
        found[place] = name
        taken.add(name)
    return found


def _name(text: str) -> str:
    plain = unicodedata.normalize("NFKD", text)
    plain = "".join(letter for letter in plain if not unicodedata.combining(letter))
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", plain).strip("_")[:56]
    return name if name[:1].isalpha() else f"V{name}"
