"""Units of a recording, judged as `connect` judges those of a server: by values and orifice law.

Columns named ``U,p1,p2,Q`` are what their names say; in question is their unit. Foreign headings
are judged when they are recognised.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from valvemap.app.recorded_oil import check_oil
from valvemap.errors import RecordingError
from valvemap.model.samples import Floats, Samples
from valvemap.pipeline.units import QUANTITY_OF, Measure, inside, unit_with
from valvemap.plant.answers import parse_answers
from valvemap.plant.candidates import Candidate
from valvemap.plant.evidence import Rating
from valvemap.plant.grouping import Group
from valvemap.plant.no_readings import no_readings
from valvemap.plant.questions import Option
from valvemap.plant.reading import Given, Record
from valvemap.plant.roles import NAMES, Role
from valvemap.plant.scales import Scale
from valvemap.plant.verdict import judge
from valvemap.storage.layout import Part
from valvemap.vocabulary.signals import REQUIRED
from valvemap.vocabulary.statuses import Quality

ROWS: Final = 600  # samples that are judged
STEP_S: Final = 0.05  # s; least distance between two of them
_NS_OF_1973: Final = 10**17
_NS_OF_A_YEAR: Final = 31_556_952 * 10**9
_TICKS: Final = {
    "1601 (FILETIME)": (125_911_584 * 10**9, 157_469_184 * 10**9),
    "the year 1 (ticks of .NET)": (630_822_816 * 10**9, 662_380_416 * 10**9),
}
"""Steps of 100 ns in 2000 to 2099, by origin; as ns since 1970 they are in 1974 and in 1990."""
_SHORTEST_STEP: Final = 100_000  # ns; a shorter one is no sampling period of a valve's signals
_FEW: Final = 10  # samples; of fewer, the times tell nothing
_LABELLED: Final = "as labelled"
_EXPLAINS: Final = 0.5  # of Q, by the orifice law; where it explains less, no unit is the remedy
_LIKELY: Final = 0.2  # of the likeliest unit's probability: one that is named beside it
_MOST_NAMED: Final = 3  # units beside the likeliest
_SPANS: Final = ((0.0, 10.0, "V"), (4.0, 20.0, "mA"), (-10.0, 10.0, "V"))  # of commands
_FILLED: Final = 0.05  # of a span: U comes so near to its ends
_INSIST: Final = "--insist (insist=True in Python) learns from it all the same"


def check_units(
    file: Path,
    valve: str,
    samples: Samples,
    part: Part,
    rating: Rating | None = None,
    *,
    configured: bool = False,
) -> None:
    """Check the units, and the times, of a valve's first samples.

    Parameters
    ----------
    file, valve, samples
        Recording, valve, and its first samples.
    part
        The valve's columns, whose units are judged.
    rating
        What the name plate states.
    configured
        Whether a configuration states the units; the remedy is in its words then.

    Raises
    ------
    RecordingError
        if the values contradict a unit; names the likelier one, and how to state it.
    """
    _check_times(file, valve, samples)
    _check_readings(file, valve, samples)
    check_oil(file, valve, samples, configured=configured, insist=_INSIST)
    if part.recognised:
        return
    if not configured and "U" not in part.stated:
        _check_span(file, valve, samples)
    some, step_s = _most_moving(samples)
    judged = NAMES - {Role.T}  # of other signals nothing is known that would contradict a unit
    stated = {signal: scaling for signal, (_, scaling) in part.numbers.items() if signal in judged}
    candidates, values, given = [], {}, Given()
    for signal, scaling in stated.items():
        role = Role.DP if signal == "p1" and "p2" not in part.numbers else Role(signal)
        unit = unit_with(scaling, QUANTITY_OF[signal])
        known = getattr(some, signal)
        candidates.append(Candidate(role, (role,), unit))
        values[str(role)] = known if unit is None else (known - scaling.offset) / scaling.gain
        scales = given.scales
        if unit is None:  # raw numbers: settled
            own = Scale(Measure(unit=inside(QUANTITY_OF[signal])), 0.0, "as stated")
            scales = {**scales, role: own}
        given = Given({**given.nodes, role: str(role)}, scales)
    group = Group(valve, tuple(candidates))
    verdict = judge(group, Record(values, step_s), given, rating)
    options = () if verdict.question is None else verdict.question.options
    others = [option for option in options if not option.text.startswith(_LABELLED)]
    if not others or _are_swapped(group, values, step_s, given):
        return
    labelled = next((one for one in options if one not in others), others[0])
    remedies = [one for one in others if _is_remedy(one, labelled)]
    as_stated = _as_stated(part, labelled, remedies, some)
    if not remedies:
        raise RecordingError(
            f"{file}: valve {valve}: the values contradict the units ({as_stated}), the orifice "
            f"law explains {100 * labelled.explained:.0f} % of Q, and not more in other "
            "units: are they the columns of this valve, of one time, in one unit throughout? "
            + _INSIST
        )
    likeliest = max(remedies, key=lambda one: (one.probability, " instead of " in one.text))
    beside = [
        one
        for one in remedies
        if one is not likeliest and one.probability >= _LIKELY * likeliest.probability
    ]
    is_sure = verdict.reading is not None and bool(verdict.reading.mistake) and not beside
    said = _remedy(_scales(likeliest, part), part, configured=configured)
    said += "".join(
        f"; or {_mistake(one)}: {_remedy(_scales(one, part), part, configured=configured)}"
        for one in beside[:_MOST_NAMED]
    )
    raise RecordingError(
        f"{file}: valve {valve}: {_claim(likeliest, is_sure=is_sure)} ({as_stated}): {said}; "
        + _INSIST
    )


def _is_remedy(other: Option, labelled: Option) -> bool:
    """Whether another reading is plausible itself: Q follows, and a contradiction is gone."""
    if other.explained < _EXPLAINS:
        return False
    told_apart = not labelled.against or not set(labelled.against) <= set(other.against)
    return told_apart or other.probability > labelled.probability


def _most_moving(samples: Samples) -> tuple[Samples, float]:
    """Return the consecutive samples in which U and √Δp move most, and their step, s."""
    steps = np.diff(samples.t)
    step_s = float(np.median(steps[steps > 0])) * 1e-9 if (steps > 0).any() else STEP_S
    stride = max(1, round(STEP_S / step_s))
    thinned = samples[::stride]
    good = thinned.quality != Quality.BAD
    drive = np.where(good, thinned.U * np.sqrt(np.abs(thinned.dp)), np.nan)
    starts = range(0, max(len(thinned) - ROWS, 0) + 1, max(ROWS // 2, 1))
    moves = [_spread(drive[start : start + ROWS]) for start in starts]
    start = starts[int(np.argmax(moves))]
    chosen = thinned[start : start + ROWS]
    return chosen[chosen.quality != Quality.BAD], step_s * stride


def _are_swapped(group: Group, values: Mapping[str, Floats], step_s: float, given: Given) -> bool:
    """Whether the pressures, swapped, are plausible in their units: `Plausibility` refuses them."""
    if not {"p1", "p2"} <= set(values):
        return False
    swapped = {**values, "p1": values["p2"], "p2": values["p1"]}
    return judge(group, Record(swapped, step_s), given).question is None


def _spread(values: Floats) -> float:
    good = values[np.isfinite(values)]
    return float(good.std()) if len(good) else 0.0


def _check_readings(file: Path, valve: str, samples: Samples) -> None:
    """Refuse numbers that stand for no reading."""
    found = no_readings({name: getattr(samples, name) for name in REQUIRED})
    if found:
        numbers = ", ".join(f"{x.signal} is {x.number:g} in {x.samples:,} samples" for x in found)
        raise RecordingError(
            f"{file}: valve {valve}: {numbers} of {len(samples):,}, one or two at a time while the "
            "other signals continue: do these numbers stand for no reading? Leave their cells "
            f"empty (NaN in Python); {_INSIST}"
        )


def _check_span(file: Path, valve: str, samples: Samples) -> None:
    """Refuse U that fills a span of volts or mA, where nothing states its unit."""
    good = samples.U[np.isfinite(samples.U)]
    if len(good) < _FEW:
        return
    least, most = float(good.min()), float(good.max())
    for low, high, symbol in _SPANS:
        slack = _FILLED * (high - low)
        if abs(least - low) <= slack and abs(most - high) <= slack:
            ends = "-100..100" if low < 0.0 else "0..100"
            span = f"{low:g}..{high:g}:{ends}%"
            raise RecordingError(
                f"{file}: valve {valve}: U is {least:.3g} … {most:.3g}, and nothing states its "
                f"unit: in {symbol}, --scale U={span} (units={{'U': '{span}'}} in Python) says so; "
                f"in %, --scale U=% (units={{'U': '%'}} in Python); {_INSIST}"
            )


def _check_times(file: Path, valve: str, samples: Samples) -> None:
    """Refuse times that are all equal, or of another unit or origin."""
    if len(samples) < _FEW:
        return
    step = float(np.median(np.diff(samples.t)))
    if (samples.t == samples.t[0]).all():
        raise RecordingError(
            f"{file}: valve {valve}: all times are equal, and t must rise; where no times were "
            "recorded, let t be the number of the row times the sampling period, in s; " + _INSIST
        )
    if 10**15 <= samples.t[0] < _NS_OF_1973 and 0.0 < step < _SHORTEST_STEP:
        raise RecordingError(
            f"{file}: valve {valve}: as ns since 1970 the times are {step * 1e-3:.3g} µs apart; "
            "for microseconds since 1970, name the column t [us] (units={'t': 'us'} in Python)"
        )
    if 0.0 < step < _SHORTEST_STEP:
        raise RecordingError(
            f"{file}: valve {valve}: the times are {step * 1e-3:.3g} µs apart; state their unit, "
            f"such as t [d] for days (units={{'t': 'd'}} in Python); {_INSIST}"
        )
    for origin, (first, last) in _TICKS.items():
        if first <= samples.t[0] < last and step > 0.0:
            raise RecordingError(
                f"{file}: valve {valve}: as ns since 1970 the times begin in the year "
                f"{1970 + samples.t[0] // _NS_OF_A_YEAR}; are they steps of 100 ns since {origin}? "
                f"Let t be seconds, (t - first t) / 1e7, then; {_INSIST}"
            )


def _mistake(option: Option) -> str:
    return option.text.partition(":")[0]


def _claim(option: Option, *, is_sure: bool) -> str:
    return _mistake(option) if is_sure else f"it may be that {_mistake(option)}"


def _as_stated(part: Part, labelled: Option, remedies: Iterable[Option], samples: Samples) -> str:
    """Return what the signals in question are as stated, and what speaks against it."""
    wanted = dict.fromkeys(name for one in remedies for name in _scales(one, part))
    spans = [_span(name, getattr(samples, name)) for name in wanted or REQUIRED]
    return f"as stated, {', '.join((*spans, *labelled.against))}"


def _span(signal: str, values: Floats) -> str:
    good = values[np.isfinite(values)]
    return f"{signal} is {good.min():.3g} … {good.max():.3g} {QUANTITY_OF[signal].value}"


def _remedy(wanted: Mapping[str, str], part: Part, *, configured: bool) -> str:
    """Return how to state units, or raw numbers and their values, by signal."""
    if configured:
        return f"{', '.join(map(_fields, wanted.items()))} in the configuration says so"
    typed = " ".join(f"--scale {name}={text}" for name, text in wanted.items())
    in_heading = [name for name in wanted if name in part.in_heading]
    if in_heading:
        headings = ", ".join(f"{name} [{wanted[name]}]" for name in in_heading)
        return f"{typed} says so, or the heading {headings}"
    return f"{typed} (units={wanted} in Python) says so"


def _fields(pair: tuple[str, str]) -> str:
    """Return the configuration's fields of a scale such as ``bar`` or ``0..10:0..100%``."""
    signal, text = pair
    measure = parse_answers((), (f"{signal}={text}",))[""].scales[Role(signal)].measure
    if measure.raw is None or measure.scaled is None:
        return f'signals.{signal}.unit = "{text}"'
    raw, scaled = ([f"{x:g}" for x in ends] for ends in (measure.raw, measure.scaled))
    return f"signals.{signal}.raw = [{', '.join(raw)}] and range = [{', '.join(scaled)}]"


def _scales(option: Option, part: Part) -> Mapping[str, str]:
    """Return the scales of an option's answers by signal, without those that the columns have."""
    found = {}
    for answer in option.answers:
        if not answer.startswith("--scale="):
            continue
        question, _, text = answer.removeprefix("--scale=").partition("=")
        name = question.rpartition(".")[2]
        signal = "p1" if name == Role.DP else name
        unit = unit_with(part.numbers[signal][1], QUANTITY_OF[signal])
        if unit is not None and text != unit.symbol:
            found[signal] = text
    return found
