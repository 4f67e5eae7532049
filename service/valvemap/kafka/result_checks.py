"""Validation of results against the group's valves: names, shapes and codes."""

from collections.abc import Collection, Mapping, Sequence
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.errors import BlockError
from valvemap.kafka.json_messages import LATEST, MOST_TEXT
from valvemap.kafka.result_blocks import ResultsBlock
from valvemap.model.survey import axes
from valvemap.pipeline.alarm_results import AlarmReport
from valvemap.pipeline.alarm_rules import ALARM_NAMES
from valvemap.pipeline.results import Results, ValveDescription
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.statuses import Adaptation, InverseStatus, Quality, Status

_SEVEREST: Final = 1_000  # alarm severity, limit of OPC UA
_MOST_LINES: Final = 100  # lines of a valve: reasons against adaptation, or timing of the signals


def check_results(block: ResultsBlock, valves: Mapping[str, ValveDescription]) -> None:
    """Check that a block can be published.

    Raises
    ------
    BlockError
        naming the column.
    """
    found = block.results
    unknown = [name for name in block.valves if name not in valves]
    if unknown:
        raise BlockError(f"group {block.group} has no valve {unknown[0]!r:.100}")
    if len(set(block.valves)) < len(block.valves):
        raise BlockError("column valve: its names must differ")
    for one in {id(valves[name]): valves[name] for name in block.valves}.values():
        _check_shapes(found, one)
    _check_codes(found)
    _check_alarms(found, len(block.valves))
    _check_lines(found.waiting, "waiting")
    _check_lines(found.timing, "timing")
    _check_lines(found.recommended, "recommended")
    _check_lines([[one.sentence for one in own] for own in found.findings], "findings")
    if not all(0.0 <= one.probability <= 1.0 for own in found.findings for one in own):
        raise BlockError("column findings: probabilities from 0 to 1 are allowed")
    if any(one.name not in ("", *found.estimators) for one in found.recommended):
        raise BlockError(f"column recommended: one of {', '.join(found.estimators)} is needed")


def _check_shapes(found: Results, valve: ValveDescription) -> None:
    described = {one.name: len(one.parameter_names) for one in valve.estimators}
    if set(found.estimators) != set(described):
        raise BlockError(f"{valve.name} has the estimators {', '.join(described)}")
    U, dp = (len(axis) for axis in axes(max(valve.dp_range)))
    for name, own in found.estimators.items():
        for column in ("theta", "std"):
            if getattr(own, column).shape[1] != described[name]:
                raise BlockError(f"column {name}.{column}: lists of {described[name]} are needed")
        if any(one is not None and one.std.shape != (U, dp) for one in own.survey):
            raise BlockError(f"column {name}.survey: a grid of {U} by {dp} is needed")
    table = len(valve.map_Q), len(valve.map_dp)
    if any(one.size and one.shape not in (table, table[::-1]) for one in found.inverse.map_U):
        raise BlockError(f"column inverse.map_U: a table of {table[0]} by {table[1]} is needed")
    if tuple(found.counter_names) != valve.counters:
        raise BlockError("metadata valvemap.counters: not the counters of this version")


def _check_codes(found: Results) -> None:
    for name, own in found.estimators.items():
        _among(own.quality, Quality, f"{name}.quality")
        _among(own.status, Status, f"{name}.status")
        _among(own.adaptation, Adaptation, f"{name}.adaptation")
        _between(own.t, f"{name}.t")
        _between(own.sample_count, f"{name}.sample_count")
        for one in own.change:
            if one is not None and not (0 <= one.t <= LATEST and one.count >= 0):
                raise BlockError(f"column {name}.change: 0 to {LATEST} is allowed")
    inverse, signals = found.inverse, found.signals
    _among(inverse.quality, Quality, "inverse.quality")
    _among(inverse.status, InverseStatus, "inverse.status")
    _among(inverse.feed_forward, FeedForwardStatus, "inverse.feed_forward")
    _between(inverse.t, "inverse.t")
    _between(found.counters, "counters")
    if signals is not None:
        _among(signals.quality, Quality, "signals.quality")
        _between(signals.t, "signals.t")


def _check_alarms(found: Results, valves: int) -> None:
    if found.alarms is None:
        return
    _between(found.alarms.version, "alarms.version")
    for m in range(valves):
        reports = found.alarms.reports(m)
        names = [one.name for one in reports]
        if len(set(names)) < len(names) or not set(names) <= set(ALARM_NAMES):
            raise BlockError("column alarms.reports: each alarm once, by its name")
        if not all(_is_sound(one) for one in reports):
            raise BlockError("column alarms.reports: a time, number or text cannot be so")


def _is_sound(one: AlarmReport) -> bool:
    times = one.since, one.at, one.commented, one.ended
    texts = one.text, one.comment, one.commented_by
    return (
        all(type(t) is int and 0 <= t <= LATEST for t in times)
        and type(one.severity) is int
        and 0 <= one.severity <= _SEVEREST
        and type(one.count) is int
        and one.count >= 0
        and all(type(flag) is bool for flag in (one.active, one.acked, one.confirmed))
        and type(one.limit) is float
        and all(type(said) is str and len(said) <= MOST_TEXT for said in texts)
    )


def _check_lines(found: Sequence[Collection[str]], name: str) -> None:
    if any(len(lines) > _MOST_LINES for lines in found):
        raise BlockError(f"column {name}: at most {_MOST_LINES} lines are allowed")
    if any(type(line) is not str or len(line) > MOST_TEXT for lines in found for line in lines):
        raise BlockError(f"column {name}: texts of at most {MOST_TEXT} characters are allowed")


def _among(codes: NDArray[np.uint8], allowed: type[IntEnum], name: str) -> None:
    wrong = ~np.isin(codes, [int(one) for one in allowed])
    if wrong.any():
        raise BlockError(f"column {name}: {codes[wrong][0]} is no {allowed.__name__}")


def _between(values: NDArray[np.int64], name: str) -> None:
    if len(values) and not (values.min() >= 0 and values.max() <= LATEST):
        raise BlockError(f"column {name}: 0 to {LATEST} is allowed")
