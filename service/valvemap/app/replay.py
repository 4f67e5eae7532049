"""Replays recordings through the pipeline of the live service and reports the fit."""

import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from valvemap.app.build import build_layout, build_plans
from valvemap.app.dp_ranges import dp_range_of_samples
from valvemap.app.given import config_in, layout_of, recordings_in
from valvemap.app.learnt_valve import LearntValve
from valvemap.app.map_checks import check_maps, summed, verified_maps
from valvemap.app.recorded_units import check_units
from valvemap.app.recording_batches import (
    FlowSplitting,
    Note,
    Progress,
    UnitCheck,
    as_warning,
    one_ahead,
    read_batches,
)
from valvemap.app.replay_report import Report, report_of
from valvemap.config.loading import check_has_valves
from valvemap.config.models import Config
from valvemap.config.valves import ValveConfig
from valvemap.errors import ConfigurationError
from valvemap.model.samples import Floats, Samples, Trace
from valvemap.pipeline.edges import LEAK
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.plant.evidence import Rating
from valvemap.plant.reading import Given
from valvemap.storage.layout import Layout, Part
from valvemap.vocabulary.edges import edges_of

Tap = Callable[[str, Samples, Mapping[str, Trace]], None]


def replay(
    recordings: object,
    config: Config | str | os.PathLike[str] | None = None,
    verify: object = None,
    progress: Progress = lambda _file, _fraction: None,
    tap: Tap = lambda _valve, _samples, _traces: None,
    *,
    insist: bool = False,
    only: Collection[str] | None = None,
    estimators: Collection[str] | None = None,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    U_range: tuple[float, float] | None = None,
    dp_range: tuple[float, float] | None = None,
    read_ahead: bool = True,
    header: tuple[str, ...] | None = None,
    given: Mapping[str, Given] | None = None,
    rating: Rating | None = None,
    note: Note = as_warning,
) -> Report:
    """Run recordings through the pipeline, one after the other; files in constant memory.

    Parameters
    ----------
    recordings, verify
        Recordings to identify from, and one to predict with the final parameters. Each is a path
        (CSV, Parquet), a data frame (pandas, polars, pyarrow; extra ``dataframes``) or a dict of
        arrays by column; ``recordings`` may be a list of them.
    config
        Valves and estimators, or the path of a file; without it the default estimators run on every
        valve found.
    progress
        Called with the file (of a table, the name of its type) and the fraction done (0 to 1).
    tap
        Called with every batch and the estimators' traces of it.
    insist
        Process implausible signals, too.
    only
        Names of the valves to identify; None: all.
    estimators
        Names of the estimators to run; None: all.
    units, columns
        Unit and column of each signal that differ from the standard, such as ``{"p1": "psi"}`` and
        ``{"U": "Control signal"}``; with ``config``, they are part of it.
    U_range
        Range of U in %, (-100, 100) of a valve that works both ways, if it is not (0, 100); the
        estimators that describe any range run then. With ``config``, it is part of it.
    dp_range
        Range of p1 - p2 in bar; by default (0, 200), or wider where a valve's first samples need
        it. With ``config``, it is part of it.
    read_ahead
        Read the next batch in a thread while one is processed; useless if all processors are
        busy.
    header, given
        Headings of files that have none, and answers about foreign headings.
    rating
        What the valve's name plate states; units that it contradicts are refused.
    note
        Called with one line for each omitted part of a recording, as columns of no valve. By
        default it is a warning.

    Returns
    -------
    Report
        By valve and estimator. ``BEST_FIT`` is the batch LSM of eq. (7) on the same samples, the
        best fit possible with the paper's structure.

    Raises
    ------
    RecordingError, ConfigurationError
    """
    config = config_in(config)
    if config is not None:
        _refuse_beside_config(U_range, dp_range)
    plans = None if config is None else {plan.name: plan for plan in build_plans(config)}
    rating = rating or Rating()
    layout = replace(
        _layout(config, units, columns), header=header, given=given or {}, rating=rating
    )
    turn = one_ahead if read_ahead else iter
    valves: dict[str, LearntValve] = {}
    found = dict[str, None]()
    splitter = FlowSplitting(plans or {})
    check = _unit_check(plans, rating, only, insist=insist)
    for recording in recordings_in(recordings):
        for name, samples in read_batches(recording, layout, progress, turn, check, note):
            found[name] = None
            if (plans and name not in plans) or (plans is None and _is_left_out(name, only)):
                continue
            covered = dp_range or dp_range_of_samples(samples)
            plan = _default_plan(name, U_range, covered) if plans is None else plans[name]
            if not _is_chosen(plan, only):
                continue
            if name not in valves:
                plan = replace(plan, insist=plan.insist or insist)
                valves[name] = LearntValve(_chosen(plan, estimators))

            def learn(name: str, some: Samples, recording: object = recording) -> Floats:
                judged, traces = valves[name].learn(valves[name].look_at(some, recording))
                tap(name, judged, traces)
                return traces[LEAK].predicted if LEAK in traces else np.empty(0)

            splitter.take(name, samples, learn)
    if not valves:
        raise _none_of(only, plans, found)
    if verify is None:
        checks = {name: [check_maps(v, v.last, scored=False)] for name, v in valves.items()}
    else:
        coming = (read_batches(one, layout, progress, turn) for one in recordings_in(verify))
        checks = verified_maps(valves, chain.from_iterable(coming), FlowSplitting(plans or {}))
    return {
        name: report_of(valve, summed(checks[name]), verified=verify is not None)
        for name, valve in valves.items()
    }


def _refuse_beside_config(
    U_range: tuple[float, float] | None, dp_range: tuple[float, float] | None
) -> None:
    if U_range is not None:
        raise ConfigurationError("with a config, U_range is its valves.U_range_percent")
    if dp_range is not None:
        raise ConfigurationError("with a config, dp_range is its valves.dp_range_bar")


def _is_chosen(plan: ValvePlan, only: Collection[str] | None) -> bool:
    """Whether a valve is chosen, a valve of which it is a part, or an edge of it as a line."""
    if only is None or plan.name in only:
        return True
    if plan.part is None:
        return False
    edges = edges_of(plan.part.line) if plan.part.edge is None else ()
    return any(
        name in only for name in (plan.part.valve, *(f"{plan.part.valve}.{e}" for e in edges))
    )


def _is_left_out(name: str, only: Collection[str] | None) -> bool:
    return only is not None and name not in only


def _unit_check(
    plans: Mapping[str, ValvePlan] | None,
    rating: Rating,
    only: Collection[str] | None,
    *,
    insist: bool,
) -> UnitCheck:
    """Return a check of the units of each valve that has one edge and a separate meter."""

    def check(file: Path, name: str, samples: Samples, part: Part) -> None:
        plan = None if plans is None else plans.get(name)
        is_single = plan is not None and plan.part is None and not plan.meter and not plan.insist
        is_found = plans is None and "." not in name and not _is_left_out(name, only)
        if not insist and (is_found or is_single):
            check_units(file, name, samples, part, rating, configured=plans is not None)

    return check


def _none_of(
    only: Collection[str] | None, plans: Collection[str] | None, found: Collection[str]
) -> ConfigurationError:
    there = ", ".join(found)
    if only is not None:
        return ConfigurationError(f"valve {', '.join(only)} is not there; allowed is {there}")
    named = ", ".join(plans or ())
    return ConfigurationError(f"the recordings hold none of the configured valves: {named}")


def _chosen(plan: ValvePlan, names: Collection[str] | None) -> ValvePlan:
    """Return the plan with the chosen estimators only."""
    if names is None or LEAK in plan.estimators:
        return plan
    for name in names:
        if name not in plan.estimators:
            known = ", ".join(plan.estimators)
            raise ConfigurationError(f"estimator {name!r} is not there; allowed is {known}")
    kept = {name: plan.estimators[name] for name in plan.estimators if name in names}
    inverse = plan.inverse if plan.inverse in kept else next(iter(kept))
    return replace(plan, estimators=kept, inverse=inverse)


def _layout(
    config: Config | None, units: Mapping[str, str] | None, columns: Mapping[str, str] | None
) -> Layout:
    if config is None:
        return layout_of(units, columns)
    if units or columns:
        raise ConfigurationError("with a config, units and columns are its valves.signals")
    check_has_valves(config, "a replay")
    return build_layout(config)


def _default_plan(
    name: str, U_range: tuple[float, float] | None, dp_range: tuple[float, float]
) -> ValvePlan:
    given: dict[str, Any] = {"dp_range_bar": dp_range}
    whole_name, is_part, _ = name.partition(".")
    if is_part:
        raise ConfigurationError(
            f"{name} is an edge or a line of {whole_name}, a valve with ports: a configuration "
            "says how they belong together (replay --config FILE; docs/ports.md)"
        )
    if U_range is not None:
        whole = [one for one in ValveConfig(name="V").estimators if one.any_U_range]
        given |= {"U_range_percent": U_range, "estimators": whole}
    try:
        valve = ValveConfig(name=name, **given)
    except ValidationError as error:
        if any("U_range_percent" in one["loc"] for one in error.errors()):
            raise ConfigurationError(
                f"U_range is {U_range!r}; a low and a high end in % are allowed, as (-100, 100)"
            ) from None
        if any("dp_range_bar" in one["loc"] for one in error.errors()):
            raise ConfigurationError(
                f"dp_range is {dp_range!r}; a low and a high end in bar are allowed, as (0, 350)"
            ) from None
        raise ConfigurationError(
            f"valve {name!r}: a name is a letter, then letters, digits, _ or -, 64 at most"
        ) from None
    (plan,) = build_plans(Config(valves=(valve,)))
    return plan
