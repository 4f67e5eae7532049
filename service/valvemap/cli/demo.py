"""``valvemap demo``: rig and service together; shows the live identification of a valve."""

import asyncio
import math
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from valvemap.app.build import build_identification
from valvemap.app.serve import serve
from valvemap.app.signals import stop_on_signal
from valvemap.app.staged_start import first_identification
from valvemap.cli import feedforward, tracking
from valvemap.cli.demo_stage import Stage
from valvemap.cli.demo_view import Verdict, status_table, verdict_table, waiting
from valvemap.cli.logs import set_up_logs
from valvemap.cli.output import terminal
from valvemap.cli.rig_conditions import conditions_in, start_in
from valvemap.cli.rig_kernels import keep_rig_kernels
from valvemap.cli.under_demo import rig_process
from valvemap.clock import SystemClock
from valvemap.config.loading import load_config
from valvemap.config.logs import LogConfig
from valvemap.config.models import Config
from valvemap.config.stores import StateConfig
from valvemap.config.valves import NodesConfig, ValveConfig
from valvemap.model.least_squares import batch_least_squares
from valvemap.model.model_structures import FiveTerms
from valvemap.model.samples import Samples
from valvemap.pipeline.identification import Identification
from valvemap_rig.condition import AS_NEW, Condition
from valvemap_rig.scenario import Scenario, load_scenario
from valvemap_rig.verification import VerificationPoints, verification_points

_COMPILING = "compiling: a minute at the very first start ..."
_MOST_MB = 100  # of the history, which is deleted with the demo's folder


def demo(
    duration: Annotated[
        float | None, typer.Option(min=0.0, metavar="S", help="End after S seconds.")
    ] = None,
    scenario: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Scenario of the rig, built in or a TOML file; feedforward and axis compare maps.",
        ),
    ] = "demo",
) -> None:
    """Run rig and service, until Ctrl-C."""
    keep_rig_kernels()
    if scenario == tracking.NAME:
        set_up_logs(LogConfig(level="error"))
        with TemporaryDirectory(prefix="valvemap-demo-") as folder:
            asyncio.run(_axis_demo(Path(folder), duration, terminal()))
        return
    loaded = load_scenario(scenario)
    if not loaded.valves:
        raise typer.BadParameter(
            f"scenario {scenario!r} has machines alone, which the demo does not show; "
            f"valvemap rig --scenario {scenario} runs it"
        )
    set_up_logs(LogConfig(level="error"))
    with TemporaryDirectory(prefix="valvemap-demo-") as folder:
        fed_forward = scenario == feedforward.NAME
        config = _demo_config(loaded, Path(folder), fed_forward=fed_forward)
        console = terminal()
        console.print("preparing the estimators ...")
        run = _feed_forward_demo if fed_forward else _demo
        asyncio.run(run(config, scenario, loaded, duration, console))


async def _demo(
    config: Config, name: str, scenario: Scenario, duration: float | None, console: Console
) -> None:
    identification = first_identification(config)
    view = _View(identification, scenario)
    stage = Stage.of(config, console, writes=False)
    console.print("starting the rig ...")
    with stop_on_signal(stage.stop):
        async with rig_process(config.source.url, name, stage.password, view.follow) as rig_url:
            if stage.stop.is_set():
                return
            console.print("starting the service ...")
            serving = serve(config, stage.stop, stage.settings, identification, view.count)
            await stage.show(serving, view, rig_url, duration)
    console.print(verdict_table(view.verdicts()))


async def _feed_forward_demo(
    config: Config, name: str, scenario: Scenario, duration: float | None, console: Console
) -> None:
    """Commission, then follow a flow with three maps until the scenario ends."""
    console.print(_COMPILING)
    identification = build_identification(config)
    stage = Stage.of(config, console, writes=True)
    with stop_on_signal(stage.stop):
        if not await stage.compile():
            return
        await asyncio.to_thread(feedforward.commission, identification, scenario)
        async with rig_process(config.source.url, name, stage.password, lambda _: None) as rig_url:
            course = feedforward.Course(identification, SystemClock().now())
            armed = feedforward.arm(identification)
            end = feedforward.END_S if duration is None else min(duration, feedforward.END_S)
            serving = serve(stage.config, stage.stop, stage.settings, identification, course.take)
            await stage.show(serving, course, rig_url, end, armed)
    console.print(course.table())


async def _axis_demo(folder: Path, duration: float | None, console: Console) -> None:
    """Commission, then follow the same moves with four feed-forwards."""
    scenario = load_scenario(tracking.SCENARIO)
    config = _axis_config(scenario, folder)
    console.print(_COMPILING)
    identification = build_identification(config)
    stage = Stage.of(config, console, writes=True)
    with stop_on_signal(stage.stop):
        if not await stage.compile():
            return
        console.print("commissioning: five minutes of work in half a minute ...")
        await asyncio.to_thread(tracking.commission, stage.config, scenario)
        course = tracking.Course(scenario, SystemClock())

        def follow(line: str) -> None:
            if (start_ns := start_in(line)) is not None:
                course.begin(start_ns)

        url, name = config.source.url, scenario.name
        async with rig_process(url, name, stage.password, follow) as rig_url:
            end = tracking.END_S if duration is None else min(duration, tracking.END_S)
            serving = serve(
                stage.config,
                stage.stop,
                stage.settings,
                identification,
                on_axis_samples=course.take,
            )
            await stage.show(serving, course, rig_url, end)
    console.print(course.table())


class _View:
    """View of the service's estimates and of the rig's true maps."""

    def __init__(self, identification: Identification, scenario: Scenario) -> None:
        self.identification = identification
        self._scenario = scenario
        self._worn: dict[str, Condition] = {}
        self._samples = dict.fromkeys((plan.name for plan in identification.plans), 0)
        self._truths: dict[str, tuple[VerificationPoints, float]] = {}
        self._clock = SystemClock()
        self._began = self._clock.monotonic()

    def follow(self, line: str) -> None:
        """Note the condition of valves from the rig's output: their true maps change with it."""
        for name, worn in conditions_in(line).items():
            if name in self._samples and worn != self._worn.get(name, AS_NEW):
                self._worn[name] = worn
                self._truths.pop(name, None)

    def count(self, valve: str, samples: Samples) -> None:
        """Count the samples of a valve."""
        self._samples[valve] += len(samples)

    def table(self) -> Table:
        """Table of the current state; while estimators wait for the compiler, without errors."""
        if self.identification.journal is None:
            return status_table(self.identification, self.verdicts())
        verdicts = [self._verdict(n, {}, math.nan, 0) for n in range(len(self._samples))]
        return status_table(self.identification, verdicts, title=self._waiting())

    def lines(self) -> list[str]:
        """Return one line for each valve; while estimators wait for the compiler, one in all."""
        if self.identification.journal is not None:
            return [
                self._waiting(),
                *(f"{name}: {n:,} samples" for name, n in self._samples.items()),
            ]
        return [verdict.line() for verdict in self.verdicts()]

    def _waiting(self) -> str:
        return waiting(self._clock.monotonic() - self._began)

    def verdicts(self) -> list[Verdict]:
        """Compare every estimator's map with the true map."""
        found = []
        for number, plan in enumerate(self.identification.plans):
            points, best = self._truth(plan.name)
            found.append(self._verdict(number, self._rmse(number, points), best, len(points.Q)))
        return found

    def _verdict(
        self, number: int, rmse: Mapping[str, float], best_fit_rmse: float, points: int
    ) -> Verdict:
        name = self.identification.plans[number].name
        return Verdict(name, self._samples[name], rmse, best_fit_rmse, points)

    def _truth(self, name: str) -> tuple[VerificationPoints, float]:
        """Points of a valve's true map, and the error of the best fit of eq. (7) to them."""
        if name not in self._truths:
            worn = self._worn.get(name, AS_NEW)
            points = verification_points(self._scenario, name, worn=worn)
            self._truths[name] = points, _best_fit(points)
        return self._truths[name]

    def _rmse(self, number: int, points: VerificationPoints) -> Mapping[str, float]:
        state = self.identification.valves.state(number)
        errors = {}
        for name, lane in state.lanes.items():
            Q_hat, _ = lane.estimator.predict(lane.state, points.U, points.dp, points.T)
            errors[name] = float(np.sqrt(np.mean((points.Q - Q_hat) ** 2)))
        return errors


def _best_fit(points: VerificationPoints) -> float:
    X = FiveTerms().regressors(points.U, points.dp, points.T)
    return float(np.sqrt(np.mean((points.Q - X @ batch_least_squares(X, points.Q)) ** 2)))


def _axis_config(scenario: Scenario, folder: Path) -> Config:
    """Return the default configuration with the scenario's axes, no valves, no security."""
    config = load_config()
    update = {
        "security": "None",
        "startup_timeout_s": 30.0,
        "publishing_interval_ms": 1000.0 * tracking.INTERVAL_S,
    }
    parts = {
        "source": config.source.model_copy(update=update),
        "valves": (),
        "axes": tracking.axes(scenario),
        "state": StateConfig(file=folder / "state.sqlite"),
    }
    return config.model_copy(update=parts)


def _demo_config(scenario: Scenario, folder: Path, *, fed_forward: bool) -> Config:
    """Return the default configuration with the scenario's valves and a history, no security."""
    config = load_config()
    update = {"security": "None", "startup_timeout_s": 30.0}
    if fed_forward:
        update["publishing_interval_ms"] = 1000.0 * feedforward.INTERVAL_S
    source = config.source.model_copy(update=update)
    valves = tuple(
        ValveConfig(name=bench.name, nodes=NodesConfig.of_rig(bench.name))
        for bench in scenario.valves
    )
    if fed_forward:
        valves = feedforward.valves()
    state = StateConfig(file=folder / "state.sqlite")
    history = config.history
    if history.file is None:
        history = history.model_copy(
            update={"file": folder / "history.sqlite", "most_mb": _MOST_MB}
        )
    parts = {"source": source, "valves": valves, "state": state, "history": history}
    return config.model_copy(update=parts)
