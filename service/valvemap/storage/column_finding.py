"""Finds the columns of a recording by the headings, and the unit of each."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

from valvemap.errors import ConfigurationError, RecordingError
from valvemap.pipeline.units import (
    QUANTITY_OF,
    SYMBOLS,
    Measure,
    Quantity,
    Scaling,
    Unit,
    relative,
    unit_of,
)
from valvemap.plant.answers import of_valve
from valvemap.storage.layout import (
    COLUMNS,
    DEFAULT_VALVE,
    REQUIRED,
    Columns,
    Layout,
    MissingColumnError,
    Part,
    ValveLayout,
)
from valvemap.storage.time_units import named_time, seconds_per_unit
from valvemap.vocabulary.signals import MEASURED

_TEMPERATURES = ("temp", "temperature", "temperatur", "oil temperature")
_IN_BRACKETS = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]]*?)[\])]\s*")
_BEHIND_A_STROKE = re.compile(r"(?P<name>.*?)(?:\s+/\s*|\s+in\s+)(?P<unit>\S+)")
_BEHIND_A_LOW_LINE = re.compile(r"(?P<name>.*)_(?P<unit>[^\s_\d]{2,}[^\s_]*|[CFcf])")


def find_columns(header: Sequence[str], layout: Layout, where: str) -> Columns:
    """Find every signal's column.

    Parameters
    ----------
    header
        The headings, in the order of the columns.
    layout
        The configured layout.
    where
        File and line, for error messages.

    Raises
    ------
    RecordingError
        if a column is missing or duplicated.
    ConfigurationError
        if heading and configuration contradict each other, or a unit cannot be that of its signal.

    Examples
    --------
    >>> found = find_columns(["Time", "q (gpm)", "u", "P1 [psi]", "P2 [psi]"], Layout(), "r.csv")
    >>> found.parts[0].numbers["Q"]
    (1, Scaling(gain=3.785411784, offset=0.0))
    """
    return _Finder(header, layout, where).columns()


class _Finder:
    def __init__(self, header: Sequence[str], layout: Layout, where: str) -> None:
        self._header = [name.strip().strip("\ufeff") for name in header]
        self._headings = [_heading(name) for name in self._header]
        self._layout = layout
        self._where = where

    def columns(self) -> Columns:
        valve = self._named(self._layout.valve, "recording.valve")
        valve = self._standard("valve") if valve is None else valve
        quality = self._named(self._layout.quality, "recording.quality")
        quality = self._standard("quality") if quality is None else quality
        parts = tuple(self._parts(valve))
        used = {number for part in parts for number, _ in part.numbers.values()}
        used |= {part.t for part in parts} | {n for n in (valve, quality) if n is not None}
        ignored = tuple(name for number, name in enumerate(self._header) if number not in used)
        return Columns(parts, valve, quality, ignored)

    def _parts(self, valve: int | None) -> Iterator[Part]:
        valves = self._layout.valves
        if not valves:
            every = ValveLayout(DEFAULT_VALVE, self._layout.signals)
            yield self._part(every, None if valve is not None else "")
            return
        alone = len(valves) == 1
        for own in valves:
            if valve is None and not alone and not own.has_columns:
                raise RecordingError(
                    f"{self._where}: whose rows are these? {len(valves)} valves are configured: "
                    f"the file needs a column valve, or each valve columns of its own "
                    f"(valves.signals.U.column)"
                )
            plain = valve is not None and own.recorded and not self._has_all_of(own)
            plain |= tuple(self._header) == COLUMNS and not own.has_columns
            layout = ValveLayout(own.valve) if plain else own
            yield self._part(layout, own.valve, selects=valve is not None)

    def _has_all_of(self, own: ValveLayout) -> bool:
        columns = {measure.column for measure in own.signals.values()} - {None}
        names = {
            name.casefold()
            for pair in zip(self._headings, self._header, strict=True)
            for name in (pair[0][0], pair[1])
        }
        return all(str(column).strip().casefold() in names for column in columns)

    def _part(self, own: ValveLayout, valve: str | None, *, selects: bool = False) -> Part:
        found: dict[str, int | None] = {"t": self._time()}
        given = of_valve(self._layout.given, own.valve)
        for signal in MEASURED:
            column = given.node_of(signal) or own.signals.get(signal, Measure()).column
            field = f"signals.{signal}.column of valve {own.valve}"
            named = self._named(column, field)
            found[signal] = named if named is not None else self._standard(signal, found["t"])
        if own.drop:
            found["p2"] = None
        needed = [name for name in REQUIRED if not (own.drop and name == "p2")]
        missing = [name for name in needed if found[name] is None]
        if missing:
            raise MissingColumnError(self._missing(missing))
        numbers = {
            signal: (number, self._scaling(own, signal, number))
            for signal in MEASURED
            if (number := found[signal]) is not None
        }
        t = found["t"]
        assert t is not None  # noqa: S101 - it is required
        seconds = self._layout.seconds
        in_heading = frozenset(s for s, (n, _) in numbers.items() if self._headings[n][1])
        elsewhere = {
            signal
            for signal, measure in own.signals.items()
            if measure.unit is not None or measure.raw is not None
        }
        return Part(
            DEFAULT_VALVE if valve == "" else valve,
            t,
            numbers,
            selects,
            seconds_per_unit(self._header[t]) if seconds is None else seconds,
            in_heading,
            in_heading | elsewhere | {str(role) for role in given.scales},
        )

    def _missing(self, missing: Sequence[str]) -> str:
        signal = next((name for name in missing if name != "t"), None)
        said = []
        if signal is not None:
            said.append(
                f'--signal {signal}=HEADING, [valves.signals.{signal}] column = "…", or '
                f'columns={{"{signal}": "…"}}'
            )
        if "t" in missing:
            said.append('the times: [recording] time = "…", or columns={"t": "…"}')
        return (
            f"{self._where}: column {', '.join(missing)} is missing; the header must hold "
            f"t,U,p1,p2,Q (and may hold T, valve, quality), found {','.join(self._header)[:50]!r}; "
            f"for other names: {'; '.join(said)}"
        )

    def _named(self, column: str | None, field: str) -> int | None:
        """Return the configured column; None if none is configured."""
        if column is None:
            return None
        wanted, folded = column.strip(), column.strip().casefold()
        names = [name for name, _ in self._headings]
        for key, among in (
            (wanted, self._header),
            (wanted, names),
            (folded, [name.casefold() for name in self._header]),
            (folded, [name.casefold() for name in names]),
        ):
            if key in among:
                return self._once(among, key)
        raise RecordingError(
            f"{self._where}: column {column!r} ({field}) is missing; "
            f"found {','.join(self._header)[:80]!r}"
        )

    def _time(self) -> int | None:
        named = self._named(self._layout.time, "recording.time")
        if named is not None:
            return named
        names = [name for name, _ in self._headings]
        found = named_time(self._header)
        if found is not None and not self._is_temperature(found):
            return self._once(names, names[found])
        if "T" in names and not self._is_temperature(names.index("T")) and self._may_be_time():
            return self._once(names, "T")
        return None

    def _may_be_time(self) -> bool:
        """Whether T may be the time: a header in capitals, or one without an unknown heading."""
        names = [name for name, _ in self._headings]
        ours = {name.casefold() for name in (*COLUMNS, "dp", *_TEMPERATURES)}
        return {"P1", "P2"} <= set(names) or all(name.casefold() in ours for name in names)

    def _is_temperature(self, number: int) -> bool:
        unit = unit_of(self._headings[number][1] or "")
        return unit is not None and unit.quantity is Quantity.TEMPERATURE

    def _standard(self, signal: str, taken: int | None = None) -> int | None:
        """Return the column with a signal's name, in any case; ``taken`` is already assigned."""
        names = [
            name if number != taken else None for number, (name, _) in enumerate(self._headings)
        ]
        if signal in names:
            return self._once(names, signal)
        folded = [None if name is None else name.casefold() for name in names]
        aliases = (signal.casefold(), *(_TEMPERATURES if signal == "T" else ()))
        for alias in aliases:
            if alias in folded:
                return self._once(folded, alias)
        return None

    def _once(self, names: Sequence[str | None], name: str) -> int:
        if names.count(name) > 1:
            raise RecordingError(f"{self._where}: column {name} stands there twice")
        return names.index(name)

    def _scaling(self, own: ValveLayout, signal: str, number: int) -> Scaling:
        answer = of_valve(self._layout.given, own.valve).scale_of(signal)
        if answer is not None:
            return answer.measure.scaling(signal)
        given = own.signals.get(signal, Measure())
        text = self._headings[number][1]
        written = None if text is None else unit_of(text)
        if text is not None and written is None:
            if given.unit is None and given.raw is None:
                raise ConfigurationError(
                    f"{self._where}: column {self._header[number]!r}: {text!r} is no unit known "
                    f"here; signals.{signal}.unit may be one of {', '.join(SYMBOLS)}"
                )
            written = None
        self._agree(own, signal, number, written)
        unit = written if given.unit is None and given.raw is None else given.unit
        if own.drop and signal == "p1" and unit is not None:
            unit = relative(unit)  # a difference has no reference
        return replace(given, unit=unit).scaling(signal)

    def _agree(self, own: ValveLayout, signal: str, number: int, written: Unit | None) -> None:
        """Reject a heading whose unit contradicts the configuration or the signal."""
        if written is None:
            return
        given = own.signals.get(signal, Measure())
        column = f"{self._where}: column {self._header[number]!r}"
        if given.raw is not None:
            if written.quantity is not Quantity.ELECTRICAL and written != given.unit:
                raise ConfigurationError(
                    f"{column} says {written.symbol}, signals.{signal}.raw of valve {own.valve} "
                    "says that it is raw; one of them is wrong"
                )
        elif given.unit is not None and written != given.unit:
            raise ConfigurationError(
                f"{column} says {written.symbol}, signals.{signal}.unit of valve {own.valve} says "
                f"{given.unit.symbol}; one of them is wrong"
            )
        elif written.quantity is Quantity.ELECTRICAL:
            raise ConfigurationError(
                f"{column} is raw, in {written.symbol}: signals.{signal}.raw and .range of valve "
                f"{own.valve} must say what it means, e.g. raw = [4, 20] and range = [0, 100]"
            )
        elif written.quantity is not QUANTITY_OF[signal]:
            raise ConfigurationError(
                f"{column}: {written.symbol} is a unit of {written.quantity.noun}, {signal} is "
                f"{_article(QUANTITY_OF[signal].noun)}"
            )


def _article(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def _heading(text: str) -> tuple[str, str | None]:
    """Split a heading into name and unit.

    >>> _heading("p1 [psi]"), _heading("Q / gpm"), _heading("U_mA"), _heading("T")
    (('p1', 'psi'), ('Q', 'gpm'), ('U', 'mA'), ('T', None))
    """
    match = _IN_BRACKETS.fullmatch(text)
    if match is not None and match["name"]:
        unit = match["unit"].strip()
        known = unit_of(unit) is not None or match["name"].casefold() in _OWN_NAMES
        return (match["name"], unit) if known and unit else (match["name"], None)
    for form in (_BEHIND_A_STROKE, _BEHIND_A_LOW_LINE):
        match = form.fullmatch(text)
        if match is not None and unit_of(match["unit"]) is not None:
            return match["name"], match["unit"]
    return text, None


_OWN_NAMES = {name.casefold() for name in MEASURED}
