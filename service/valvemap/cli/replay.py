"""``valvemap replay``: processes recordings with the live pipeline and reports the fit."""

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from valvemap.cli.history import recordings_of
from valvemap.cli.options import (
    ConfigOption,
    ForceOption,
    InsistOption,
    RatedDropOption,
    RatedFlowOption,
    new_file,
    new_models,
    new_pages,
)
from valvemap.cli.output import terminal
from valvemap.cli.progress import bars, of_files, working
from valvemap.config.loading import load_config
from valvemap.model.extrapolation import ranges_of
from valvemap.owned_files import write_whole
from valvemap.vocabulary.edges import EDGES

_BEYOND = "beyond_range"  # has a separate line

if TYPE_CHECKING:
    from valvemap.app.replay import Tap
    from valvemap.app.replay_report import EstimatorReport, Report
    from valvemap.model.samples import Samples, Trace
    from valvemap.pipeline.row_tallies import RowTallies
    from valvemap.report.replay_plots import ReplayPlots


def replay(
    files: Annotated[
        list[str],
        typer.Argument(
            help="Recordings, in the order of their time; or the url of a server with a history.",
        ),
    ],
    config: ConfigOption = None,
    verify: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Recording to predict with the final parameters."),
    ] = None,
    json_out: Annotated[
        Path | None,
        typer.Option("--json", metavar="OUT", help="Write all figures as JSON.", callback=new_file),
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL",
            help="Save the map (FILE.json), or every map in a folder.",
            callback=new_models,
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Draw the identified maps: PNG files and an index.html.",
            callback=new_pages,
        ),
    ] = None,
    since: Annotated[
        str | None,
        typer.Option("--from", metavar="T", help="Of a history: first time, ISO 8601 or UTC ns."),
    ] = None,
    until: Annotated[
        str | None, typer.Option("--to", metavar="T", help="Of a history: last time; none = now.")
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(metavar="NAMES", help="Columns of a file without headings: t,U,p1,p2,Q."),
    ] = None,
    signal: Annotated[
        list[str] | None,
        typer.Option(metavar="SIGNAL=HEADING", help="Answer: the column of U, p1, p2, Q, T, dp."),
    ] = None,
    scale: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SIGNAL=UNIT",
            help="Answer: a unit, or raw numbers and values, such as 0..27648:0..250bar.",
        ),
    ] = None,
    rated_flow: RatedFlowOption = 0.0,
    rated_drop: RatedDropOption = 35.0,
    *,
    force: ForceOption = False,
    insist: InsistOption = False,
) -> None:
    """Identify valves from recordings, as the live service does."""
    from valvemap.app.models import save_models
    from valvemap.app.replay import replay as run
    from valvemap.app.replay_report import as_json, refuse_if_nothing_was_learnt
    from valvemap.pipeline.edges import LEAK
    from valvemap.pipeline.row_tallies import RowTallies
    from valvemap.plant.answers import parse_answers
    from valvemap.plant.evidence import Rating
    from valvemap.report.verification import verification_table

    loaded = None if config is None else load_config(config)
    rows, left_out = RowTallies(), list[str]()
    plots = None
    if plot is not None:  # matplotlib is an extra
        from valvemap.report.replay_plots import ReplayPlots

        plots = ReplayPlots(plot)
    with recordings_of(files, config, since, until) as recordings, bars() as progress:
        report = run(
            recordings,
            loaded,
            verify,
            of_files(progress),
            _tap(rows, plots),
            insist=insist,
            header=tuple(columns.split(",")) if columns else None,
            given=parse_answers(signal or (), scale or ()),
            rating=Rating(flow_l_min=rated_flow, drop_bar=rated_drop),
            note=left_out.append,
        )
    console = terminal()
    report = {valve: _best_first(estimators) for valve, estimators in report.items()}
    one_step = {v: {n: r.one_step for n, r in e.items()} for v, e in report.items()}
    again = {v: {n: r.again for n, r in e.items()} for v, e in report.items()}
    title = "Errors at places visited again, and one step ahead before each update"
    tables = [verification_table(title, one_step, again)]
    if verify is not None:
        verified = {v: {n: r.verify for n, r in e.items() if r.verify} for v, e in report.items()}
        tables.append(verification_table(f"Verified on {verify.name}, no adaptation", verified))
    tables.append(_trust_table(report))
    for table in tables:
        console.print(table)
    of_drops = {valve: e for valve, e in report.items() if LEAK not in e}  # a line has no drop
    notes = [
        *_recommended(of_drops),
        *_findings(report),
        *_not_learnt_from(report),
        *_dropped(report),
        *rows.lines(),
        *left_out,
        *_hints(of_drops),
    ]
    for line in notes:
        console.print(line, soft_wrap=True, highlight=False)
    if json_out is not None:
        write_json(json_out, as_json(report))
    if save is not None:
        for written in save_models(save, report):
            console.print(f"written: {written}")
    if plots is not None and plot is not None:
        from valvemap.report.replay_page import write_page

        lanes = {v: {n: r.lane for n, r in e.items()} for v, e in report.items()}
        with working("drawing"):
            pictures = list(plots.write(lanes))
            title = f"Replay of {', '.join(Path(file).name for file in files)}"
            page = write_page(plot, title, tables, notes, pictures)
        for written in (*pictures, page):
            console.print(f"written: {written}", soft_wrap=True)
    refuse_if_nothing_was_learnt(report)


def _best_first(estimators: "Mapping[str, EstimatorReport]") -> "dict[str, EstimatorReport]":
    """Return the estimators by their error at places visited again; unranked ones are last."""

    def rank(name: str) -> float:
        error = estimators[name].again
        return math.inf if math.isnan(error) else error

    first = next(iter(estimators.values())).recommended.name
    ranked = sorted(estimators, key=lambda name: (name != first, rank(name)))
    return {name: estimators[name] for name in ranked}


def _recommended(report: "Report") -> Iterator[str]:
    """Yield a line for each valve: the recommended estimator, and why."""
    for valve, estimators in report.items():
        found = next(iter(estimators.values())).recommended
        yield f"{valve}: recommended: {found.name or 'none'}. {found.reason}"


def _findings(report: "Report") -> Iterator[str]:
    """Yield a line for each cause that an estimator of a valve found, the likeliest first."""
    from valvemap.pipeline.valve_state import merged_findings

    for valve, estimators in report.items():
        for one in merged_findings(r.findings for r in estimators.values()):
            yield f"{valve}: {one.code.label} ({one.probability:.0%}): {one.sentence}"


def _tap(rows: "RowTallies", plots: "ReplayPlots | None") -> "Tap":
    """Return a tap that counts rows, and draws them if they are to be drawn.

    Rows of an edge are those at which it is open; its line has them all.
    """

    def tap(valve: str, samples: "Samples", traces: "Mapping[str, Trace]") -> None:
        if valve.partition(".")[2] not in EDGES:
            rows.count(valve, samples)
        if plots is not None:
            plots.take(valve, samples, traces)

    return tap


def _dropped(report: "Report") -> Iterator[str]:
    """Yield a line for each valve with samples that were not learnt from."""
    for valve, estimators in report.items():
        r = next(iter(estimators.values()))
        why = {reason.replace("_", " "): n for reason, n in r.rejected.items() if reason != _BEYOND}
        if why:
            reasons = ", ".join(f"{reason} {n:,}" for reason, n in why.items())
            yield f"{valve}: rows dropped: {sum(why.values()):,} of {r.samples:,} ({reasons})"


def _hints(report: "Report") -> Iterator[str]:
    """Yield a line for each hint on a valve's signals."""
    for valve, estimators in report.items():
        for hint in dict.fromkeys(hint for r in estimators.values() for hint in r.hints):
            yield f"{valve}: hint: {hint}"


def _not_learnt_from(report: "Report") -> Iterator[str]:
    """Yield a line for each valve with samples outside an estimator's ranges."""
    for valve, estimators in report.items():
        name, most = max(estimators.items(), key=lambda one: one[1].beyond_range)
        if most.beyond_range:
            yield (
                f"{valve}: not learnt from, because U or p1 - p2 lay beyond what an estimator "
                f"can describe ({name}: {ranges_of(most.lane.estimator)}): "
                f"{most.beyond_range} samples; U_range_percent = [-100, 100] or dp_range_bar = "
                "[0, 400] in a --config FILE covers them"
            )


def _trust_table(report: "Report") -> Table:
    """Table of each map's uncertainty, and of the operating point to measure next."""
    table = Table(title="Trust: noise, 95 % interval, where to measure next", title_justify="left")
    for heading in ("valve", "estimator"):
        table.add_column(heading)
    for heading in ("noise, l/min", "covered, %", "regions seen, %", "next U, %", "next dp, bar"):
        table.add_column(heading, justify="right")
    for valve, estimators in report.items():
        for name, r in estimators.items():
            figures = r.noise_std, 100 * r.covered, 100 * r.survey.share
            shown = [f"{x:.3g}" for x in (*figures, r.survey.suggested_U, r.survey.suggested_dp)]
            table.add_row(valve, name, *shown)
    return table


def write_json(file: Path, content: object) -> None:
    """Write ``content`` as JSON.

    Raises
    ------
    StorageError
        naming the file.
    """
    write_whole(file, json.dumps(content, indent=2, allow_nan=False) + "\n")
