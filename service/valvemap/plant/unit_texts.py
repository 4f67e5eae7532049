"""Units as plants write them: in a heading, behind a name, in full width; and units of others."""

import re
import unicodedata
from collections.abc import Mapping
from typing import Final

from valvemap.pipeline.units import QUANTITY_OF, Quantity, Unit, unit_of

_IN_BRACKETS = re.compile(
    r"(?P<name>.*?)\s*[\[(<{【](?P<unit>[^\[\]()]*(?:\([^()]*\))?)[\])>}】]\s*"
)
_BOUNDARY = re.compile(
    r"\s+/\s*|\s+in\s+|\s*,\s*|[_\s.]+|(?<=[\u4e00-\u9fff])(?=[a-zA-Z%°])"
    r"|(?<=[a-z)\d])(?=MPa|kPa|Bar|PSI|Psi|GPM|Gpm|LPM|Lpm|Deg[CF])"
)
_INDEX = re.compile(r"(?P<name>.*\w)\[\d+(?:\s*,\s*\d+)*\]")
_NUMBER_BEHIND = re.compile(r"(?P<name>.+?)(?P<number>[_\s#.-]+\d+号?)")
_ALSO: Final = {
    "lmin": "l/min",
    "l/mn": "l/min",
    "l_min": "l/min",
    "lmn": "l/min",
    "m3h": "m³/h",
    "m3_h": "m³/h",
    "升/分": "l/min",
    "升/分钟": "l/min",
    "兆帕": "MPa",
    "千帕": "kPa",
    "巴": "bar",
    "立方米/小时": "m³/h",
    "摄氏度": "°C",
    "kg/cm2": "kgf/cm²",
    "us_gpm": "gpm",
    "л/мин": "l/min",
    "м3/ч": "m³/h",
    "бар": "bar",
    "мпа": "MPa",
    "кпа": "kPa",
    "кгс/см2": "kgf/cm²",
    "кг/см2": "kgf/cm²",
    "l/dak": "l/min",
    "percent": "%",
    "pc": "%",
    "proz": "%",
}
_UNIT_WORDS: Final[Mapping[str, str]] = {
    word: symbol
    for symbol, words in {
        "l": "litre litres liter liters litro litros litri litrow litra",
        "m3": "cubic_metre cubic_metres cubic_meter cubic_meters kubikmeter metre_cube "
        "metres_cubes metro_cubico metros_cubicos metri_cubi",
        "gal": "gallon gallons us_gallons galones galloni",
        "min": "minute minutes minuto minuti minuta minute minut",
        "h": "hour hours stunde stunden heure heures hora horas ora ore godzine",
        "s": "second seconds sekunde sekunden seconde secondes segundo segundos secondo secondi",
    }.items()
    for word in words.split()
}  # fmt: skip
_PER: Final = re.compile(r"[ _]*(?:/|\bper\b|\bpro\b|\bpar\b|\bpor\b|\bal\b|\ball'|\bna\b)[ _]*")
_WHOLE_UNITS: Final[Mapping[str, str]] = {
    "gal/min": "gpm",
    "megapascal": "MPa",
    "kilopascal": "kPa",
    "pascal": "Pa",
    "millibar": "mbar",
    "pounds/square inch": "psi",
    "degrees celsius": "°C",
    "degree celsius": "°C",
    "grad celsius": "°C",
    "degrees fahrenheit": "°F",
    "prozent": "%",
    "per cent": "%",
    "pourcent": "%",
}
"""Units that are written out, by the words for their parts, or whole."""
_WORD_BEGINS: Final = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_VACUUM: Final = re.compile(
    r"(?i)(?<![a-z])(?:abs|absolute?|absolut[ao]|absolu|assolut[ao]|absolutdruck)(?![a-z])"
    r"|绝对压|绝压|絶対圧|절대압"
)
_GAUGE: Final = re.compile(
    r"(?i)(?<![a-z])(?:bar|mbar|kpa|mpa|psi)\s*(?:g|\(g\)|ü|\(ü\)|\(?gauge\)?|\(?rel\)?)(?![a-z])"
    r"|überdruck|ueberdruck|relativdruck|gauge pressure|表压|ゲージ圧"
)
_SINGLE: Final = frozenset("cfCFKV%")  # letters that are units behind a low line
_OTHERS = """
mm cm m µm um inch in mm/s m/s m/min cm/s in/s rpm 1/min u/min min-1 r/min tr/min n kn mn nm knm
kw w hz khz s ms h kg t deg rad v/s cst mm2/s ppm db g m/s2 kwh a
"""
_OURS: Final = {*QUANTITY_OF.values(), Quantity.ELECTRICAL}
OF_OTHERS: Final = frozenset(_OTHERS.split())
"""Units of quantities that no signal of a valve has."""
_ALSO_WORDS: Final = frozenset({"in", "deg", "a", "n", "t", "s", "h", "m", "g", "w"})


def split_unit(text: str) -> tuple[str, Unit | None, str]:
    """Split a name into name, unit (None if it is none of ours), and the unit's text.

    >>> [split_unit(t)[1].symbol for t in ("p1 [kPa]", "pIn_MPa", "阀前压力ＭＰａ", "Q / m3/h")]
    ['kPa', 'MPa', 'MPa', 'm³/h']
    >>> split_unit("Hub [mm]"), split_unit("PT-7 supply")
    (('Hub', None, 'mm'), ('PT-7 supply', None, ''))
    >>> split_unit("p_in_bar_2")[0], split_unit("p_in_bar_2")[1].symbol
    ('p_in_2', 'bar')
    >>> split_unit("cmd[1]"), split_unit("Opening [1]")[1].symbol  # an element, and a unit
    (('cmd', None, ''), '1')
    """
    plain = unicodedata.normalize("NFKC", text).strip()
    if (element := _INDEX.fullmatch(plain)) is not None:
        plain = element["name"]
    whole = _split(plain)
    number = _NUMBER_BEHIND.fullmatch(plain)
    if whole[2] or number is None:
        return whole
    name, unit, shown = _split(number["name"])
    return (f"{name}{number['number']}", unit, shown) if shown else whole


def _split(plain: str) -> tuple[str, Unit | None, str]:
    match = _IN_BRACKETS.fullmatch(plain)
    if match is not None and match["name"] and match["unit"].strip():
        shown = match["unit"].strip()
        unit = known_unit(shown)
        if unit is not None or is_of_others(shown) or plain.endswith("]"):
            return match["name"], unit, shown
    for boundary in _BOUNDARY.finditer(plain):
        name, shown = plain[: boundary.start()], plain[boundary.end() :]
        if not name or not shown or (len(shown) == 1 and shown not in _SINGLE):
            continue
        if shown.casefold().endswith((" a", " b", " g")):
            continue  # the letter of a port, or of a gauge
        unit = known_unit(shown)
        is_other = unit is None and is_of_others(shown) and shown.casefold() not in _ALSO_WORDS
        if (unit is not None or is_other) and not shown.isdigit():
            return name, unit, shown
    return plain, None, ""


def known_unit(text: str) -> Unit | None:
    """Return the unit of a text in any spelling; None if no signal of a valve has it.

    >>> [known_unit(text).symbol for text in ("LPerMin", "CubicMetersPerHour", "KPA")]
    ['l/min', 'm³/h', 'kPa']
    """
    whole = unicodedata.normalize("NFKC", text).strip()
    plain = whole.casefold()
    unit = (
        unit_of(_ALSO.get(plain, plain))
        or unit_of(plain.replace("_", "/"))
        or unit_of(_written_out(plain))
        or unit_of(_written_out(_WORD_BEGINS.sub(" ", whole).casefold()))  # LPerMin
    )
    return unit if unit is not None and unit.quantity in _OURS else None


def _written_out(plain: str) -> str:
    """Return the symbol of a unit that is written out, else the text.

    >>> [_written_out(text) for text in ("litres per minute", "gallons/minute", "kilopascal")]
    ['l/min', 'gpm', 'kPa']
    """
    parts = [part.strip().replace(" ", "_") for part in _PER.split(plain)]
    symbols = "/".join(_UNIT_WORDS.get(part, part.replace("_", " ")) for part in parts)
    return _WHOLE_UNITS.get(plain) or _WHOLE_UNITS.get(symbols, symbols)


def is_of_vacuum(*texts: str) -> bool:
    """Whether words say that a pressure is absolute.

    >>> is_of_vacuum("bar abs"), is_of_vacuum("", "p_abs"), is_of_vacuum("bar", "Absperrventil")
    (True, True, False)
    """
    return any(_VACUUM.search(unicodedata.normalize("NFKC", text)) for text in texts)


def is_of_gauge(*texts: str) -> bool:
    """Whether words or a unit say that a pressure is one against the atmosphere.

    >>> is_of_gauge("barg"), is_of_gauge("bar", "p1 Überdruck"), is_of_gauge("bar", "Gauge 1")
    (True, True, False)
    """
    return any(_GAUGE.search(unicodedata.normalize("NFKC", text)) for text in texts)


def is_of_others(text: str) -> bool:
    """Whether a text is the unit of a quantity that no signal of a valve has."""
    return unicodedata.normalize("NFKC", text).strip().casefold() in OF_OTHERS
