"""Foreign headings of a recording: columns recognised as `connect` recognises nodes.

Used where the headings are not ``t,U,p1,p2,Q``: names and units in any language, tags of several
valves, one transmitter of Δp. What remains ambiguous is an error with an answer for each reading.
"""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from valvemap.errors import RecordingError
from valvemap.foreign_text import printable
from valvemap.model.samples import Floats, Times
from valvemap.pipeline.units import QUANTITY_OF, inside
from valvemap.plant.answers import of_valve
from valvemap.plant.candidates import Candidate
from valvemap.plant.grouping import Group, group
from valvemap.plant.questions import Option
from valvemap.plant.reading import Given, Reading, Record
from valvemap.plant.roles import NAMES, Role
from valvemap.plant.scales import Scale
from valvemap.plant.unit_texts import split_unit
from valvemap.plant.verdict import Verdict, judge
from valvemap.storage.layout import DEFAULT_VALVE, Columns, Layout, Part
from valvemap.storage.time_units import named_time, seconds_per_unit

_PLAIN: Final = {name.casefold(): name for name in ("U", "p1", "p2", "Q", "T", "dp")}
_COUNTS_FROM: Final = 1_000.0  # whole numbers beyond it may be raw counts
_INTEGER_TYPES: Final = (2.0**15 - 1, 2.0**16 - 1, 2.0**31 - 1)


@dataclass(frozen=True)
class Beginning:
    """The first rows of a file: headings, the number of each cell by column, and times in ns."""

    path: Path
    headings: Sequence[str]
    numbers: Mapping[int, Floats]
    time: int
    times: Times = field(default_factory=lambda: np.zeros(0, np.int64))


def time_column(headings: Sequence[str], numeric: Sequence[bool]) -> int | None:
    """Return the column of the times: by its name, else the first if it holds no number.

    >>> time_column(["Druck [bar]", "Zeit [ms]", "T"], [True, True, True])
    1
    """
    named = named_time(headings)
    return 0 if named is None and numeric and not numeric[0] else named


def recognise(begins: Beginning, layout: Layout, refusal: RecordingError) -> Columns:
    """Return the columns of a file with foreign headings.

    Raises
    ------
    RecordingError
        ``refusal`` if no whole valve is found; or if a reading is ambiguous: it names the answers.
    """
    candidates = [
        _candidate(begins.headings[number], values)
        for number, values in begins.numbers.items()
        if number != begins.time
    ]
    groups = _named(group(candidates), layout)
    if not groups:
        raise refusal
    steps = np.diff(np.unique(begins.times)) * 1e-9
    record = Record(
        {begins.headings[number]: values for number, values in begins.numbers.items()},
        float(np.median(steps)) if len(steps) else 1.0,
    )
    verdicts = [judge(one, record, _given(one, layout), layout.rating) for one in groups]
    open_ = [verdict for verdict in verdicts if verdict.question is not None]
    if any(verdict.question is not None and not verdict.question.options for verdict in open_):
        raise refusal
    if open_:
        alone = len(verdicts) == 1
        raise RecordingError(
            "\n".join(line for v in open_ for line in _question(begins, v, alone=alone))
        )
    parts = tuple(_part(v.valve, v.reading, begins) for v in verdicts if v.reading is not None)
    used = {number for part in parts for number, _ in part.numbers.values()} | {begins.time}
    ignored = tuple(name for number, name in enumerate(begins.headings) if number not in used)
    return Columns(parts, None, None, ignored)


def _candidate(heading: str, values: Floats) -> Candidate:
    plain = _PLAIN.get(heading.strip().casefold())
    unit = inside(QUANTITY_OF[plain]) if plain is not None else None
    good = values[np.isfinite(values)]
    top = float(np.abs(good).max(initial=0.0))
    is_stated = unit is not None or split_unit(heading)[1] is not None
    whole = (
        not is_stated
        and bool(len(good))
        and bool((good == np.round(good)).all())
        and top > _COUNTS_FROM
    )
    largest = next((most for most in _INTEGER_TYPES if top <= most), None) if whole else None
    return Candidate(heading, (heading,), unit, largest=largest)


def _named(groups: Sequence[Group], layout: Layout) -> list[Group]:
    """Name a single valve as configured, or by the default."""
    if len(groups) != 1:
        return list(groups)
    configured = [valve.valve for valve in layout.valves]
    name = configured[0] if len(configured) == 1 else DEFAULT_VALVE
    return [replace(groups[0], name=name)]


def _given(one: Group, layout: Layout) -> Given:
    given = of_valve(layout.given, one.name)
    stated = {
        Role(signal): Scale(replace(measure, column=None), 0.0, "as stated")
        for signal, measure in layout.signals.items()
        if signal in NAMES and (measure.unit is not None or measure.raw is not None)
    }
    return replace(given, scales={**stated, **given.scales})


def _part(valve: str, reading: Reading, begins: Beginning) -> Part:
    numbers = {}
    for role, node in reading.nodes.items():
        name = "p1" if role is Role.DP else str(role)
        scaling = reading.scales[role].measure.scaling(str(role))
        numbers[name] = (list(begins.headings).index(node.node), scaling)
    factor = seconds_per_unit(begins.headings[begins.time])
    return Part(valve, begins.time, numbers, seconds=factor, recognised=True)


def _question(begins: Beginning, verdict: Verdict, *, alone: bool) -> Iterator[str]:
    question = verdict.question
    if question is None:
        return
    yield f"{begins.path}: {verdict.valve}: {printable(question.about)}"
    file = shlex.quote(printable(str(begins.path)))
    by_configuration = (f"--ports={verdict.valve}",)
    options = [one for one in question.options if one.answers != by_configuration]
    for number, option in enumerate(options, 1):
        yield f"  {number}. {printable(option.text)} ({100 * option.probability:.0f} %)"
        yield f"     {printable(option.consequence)}"
        answers = " ".join(shlex.quote(answer) for answer in option.answers)
        yield f"     answer: valvemap replay {file} {answers}"
        if alone:
            yield f"     in Python: {printable(_in_python(option))}"


def _in_python(option: Option) -> str:
    """Return an answer as arguments of `valvemap.fit`, which have no valve's name."""
    given: dict[str, dict[str, str]] = {"--signal": {}, "--scale": {}}
    for answer in option.answers:
        what, place, text = answer.split("=", 2)
        role = place.rpartition(".")[2]
        given[what]["p1" if role == Role.DP else role] = text
    return f"columns={given['--signal']}, units={given['--scale']}"
