"""Columns of times: their names, and their units as the heading states them."""

import re
import unicodedata
from collections.abc import Sequence
from typing import Final

from valvemap.plant.names import tokens

_NAMES: Final = """
time timestamp datetime date zeit zeitstempel datum uhrzeit temps horodatage tiempo fecha hora tempo
ora 时间 时刻 日期 czas tijd tid tiden cas zaman tarih saat время дата 時刻 時間 日時 시간 시각 일시
ts elapsed
"""
_WORDS: Final = frozenset(word for name in _NAMES.split() for word in tokens(name))
_SECONDS: Final = {
    1.0: "s sec secs second seconds sek sekunde sekunden seconde secondes segundo segundos secondo "
    "secondi sekund saniye 秒",
    1e-3: "ms msec msecs millisecond milliseconds millisekunde millisekunden milliseconde "
    "millisecondes milisegundo milisegundos millisecondi milisekund 毫秒",
    1e-6: "us \u00b5s \u03bcs usec microsecond microseconds mikrosekunden microsecondes "
    "microsegundos 微秒",  # micro sign, Greek letter
    1e-9: "ns nsec nanosecond nanoseconds nanosekunden nanosecondes nanosegundos 纳秒",
    60.0: "min mins minute minutes minuten minuto minutos minuti minut dakika 分",
    3600.0: "h hr hrs hour hours stunde stunden std heure heures hora horas ore saat 小时",
    86400.0: "d day days tag tage jour jours dia dias giorno giorni dni gun 天",
}
TIME_UNITS: Final = {text: factor for factor, texts in _SECONDS.items() for text in texts.split()}
"""Seconds of one unit, by how it is written."""
SYMBOLS: Final = ("s", "ms", "us", "ns", "min", "h", "d")
"""The units of times, as messages name them."""
UNKNOWN: Final = float("nan")
"""Seconds of one unit where the heading states none of these."""
_NO_UNITS: Final = frozenset(
    {
        "utc", "gmt", "local", "lokal", "cet", "cest", "mez", "mesz", "unix", "posix", "epoch",
        "iso", "abs", "absolute", "rel", "relative", "elapsed", "since", "start", "source",
        "server", "plc", "excel",
    }
)  # fmt: skip
"""Words in brackets that state a zone or an origin."""
_ALSO_WORDS: Final = frozenset({"day", "days", "hour", "hours", "tag", "tage", "d", "h", "gun"})
_IN_BRACKETS: Final = re.compile(r"(?P<name>.+?)\s*[\[(<{【](?P<unit>[^\[\]]*?)[\])>}】]")
_BEHIND: Final = re.compile(r"(?P<name>.+?)(?:\s*/\s*|\s+in\s+|[\s,_.]+)(?P<unit>[^\W\d_]+)")


def seconds_per_unit(heading: str, unknown: float = UNKNOWN) -> float:
    """Return the seconds of one unit of a time column; ``unknown`` if another unit is stated.

    >>> [seconds_per_unit(t) for t in ("Zeit [ms]", "Time (seconds)", "t_ms", "t", "t [ticks]")]
    [0.001, 1.0, 0.001, 1.0, nan]
    >>> [seconds_per_unit(t) for t in ("Time (UTC)", "t (ms since 1970)", "Elapsed time in min")]
    [1.0, 0.001, 60.0]
    """
    stated = _split(heading)[1]
    words = tokens(stated)
    if words and words[0].isdecimal():
        return unknown  # a multiple: 100 ns
    known = [TIME_UNITS[text] for text in (stated.casefold(), *words) if text in TIME_UNITS]
    return known[0] if known else 1.0 if not stated or _NO_UNITS & set(words) else unknown


def named_time(headings: Sequence[str]) -> int | None:
    """Return the column that is named as times are: `t`, else the first with a word for times.

    >>> named_time(["Druck [bar]", "Zeit [ms]", "T"]), named_time(["T", "t_ms"]), named_time(["T"])
    (1, 1, None)
    """
    names = [_split(heading)[0] for heading in headings]
    if "t" in names:
        return names.index("t")
    named = (number for number, name in enumerate(names) if _WORDS & set(tokens(name)))
    return next(named, None)


def _split(heading: str) -> tuple[str, str]:
    """Return name and unit of a column that may be one of times; any text in brackets is a unit."""
    plain = unicodedata.normalize("NFKC", heading).strip()
    if (match := _IN_BRACKETS.fullmatch(plain)) is not None:
        return match["name"].strip(), match["unit"].strip()
    match = _BEHIND.fullmatch(plain)
    if match is not None and match["unit"].casefold() in TIME_UNITS.keys() - _ALSO_WORDS:
        return match["name"].strip(), match["unit"]
    return plain, ""
