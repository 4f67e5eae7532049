"""Runs the axes of a configuration, beside its valves."""

import asyncio
import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Protocol

import structlog

from valvemap.app.build import alignment_of, feed_forward_of, timing_of
from valvemap.clock import Clock
from valvemap.config.axes import MEASURED, AxisConfig
from valvemap.config.models import Config
from valvemap.model.axis import AxisGeometry
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_arrivals import LINES
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.axis_ports import AxisOperator, AxisResults
from valvemap.pipeline.axis_states import AxisStates
from valvemap.pipeline.meaning import Meaning, SignalMeaning
from valvemap.pipeline.source_ports import AllSources
from valvemap.pipeline.store_ports import CheckpointStore, KeptElsewhere, Piece
from valvemap.runtime.axes import AxisTap, LiveAxes
from valvemap.runtime.sources import Sources, supervise_all
from valvemap.runtime.supervisor import SupervisorSettings
from valvemap.runtime.transferred_states import TransferredStates, transfer

log = structlog.get_logger(__name__)


class AxisServer(Protocol):
    """Shows axes."""

    async def follow_axes(self, axes: Sequence[str], operator: AxisOperator | None) -> None:
        """Show these axes, in place of those before."""

    def show_axis(self, axis: str, results: AxisResults) -> None:
        """Show the newest results of one axis."""


async def run_axes(
    config: Config,
    server: AxisServer,
    clock: Clock,
    stop: asyncio.Event,
    sources: Sources,
    supervision: SupervisorSettings,
    open_store: Callable[[], TransferredStates],
    note_states: Callable[[KeptElsewhere], None],
    tap: AxisTap | None = None,
    keep: Callable[[Sequence[Piece]], None] | None = None,
) -> None:
    """Identify the axes of a configuration until ``stop`` is set; without axes, show none.

    ``sources`` are their servers; ``open_store`` opens the store of their states, once for all
    configurations; ``note_states`` gets the keeper of the states, ``tap`` the samples, ``keep``
    rows for the history.

    Raises
    ------
    SourceError, StorageError
        at the start; a source that is lost later is retried.
    """
    if not config.axes:
        await server.follow_axes([], None)
        return
    store = open_store()
    live = build_live_axes(config, server, sources, store, clock, tap, keep)
    await server.follow_axes(live.names, live)
    live.start()
    note_states(live.keeper)
    try:
        await supervise_all(sources, live, clock, stop, supervision)
    finally:
        await transfer(live.keeper, live.finish, store)


def build_live_axes(
    config: Config,
    server: AxisServer,
    source: AllSources,
    store: CheckpointStore,
    clock: Clock,
    tap: AxisTap | None = None,
    keep: Callable[[Sequence[Piece]], None] | None = None,
) -> LiveAxes:
    """Return the axes of a configuration, before the first sample."""
    return LiveAxes(
        build_axis_plans(config),
        _build_arrivals(config),
        server,
        source,
        store,
        clock,
        reorder_s=config.alignment.reorder_ms * 1e-3,
        stale_after_s=config.alignment.stale_after_s,
        checkpoint_interval_s=config.state.checkpoint_interval_s,
        tap=tap,
        keep=keep,
    )


def build_axis_states(config: Config) -> AxisStates:
    """Return the states of all axes, before the first sample."""
    return AxisStates([Axis(plan) for plan in build_axis_plans(config)], _build_arrivals(config))


def _build_arrivals(config: Config) -> Arrivals:
    """Return the arrivals of both lines of all axes."""
    names = [axis.name for axis in config.axes for _ in range(LINES)]
    optional = tuple(
        () if node is None else ("T",)
        for axis in config.axes
        for node in (axis.nodes.T, axis.nodes.set_position)
    )
    has_sequence = tuple(
        axis.nodes.sequence is not None for axis in config.axes for _ in range(LINES)
    )
    return Arrivals(
        names,
        alignment_of(config, optional, has_sequence),
        timing_of(config, optional, has_sequence),
    )


def build_axis_plans(config: Config) -> list[AxisPlan]:
    """Return a plan per axis."""
    return [plan_of(config, axis) for axis in config.axes]


def plan_of(config: Config, axis: AxisConfig) -> AxisPlan:
    """Return the plan of one axis of a configuration."""
    dead_B_l = axis.dead_A_l if axis.dead_B_l is None else axis.dead_B_l
    geometry = AxisGeometry(axis.piston_mm, axis.rod_mm, axis.stroke_mm, axis.dead_A_l, dead_B_l)
    return AxisPlan(
        axis.name,
        geometry,
        axis.memory_s,
        _meaning_of(config, axis),
        feed_forward_of(axis),
        axis.frozen,
        axis.nodes.speed is not None,
        axis.nodes.set_position is not None,
        _former_key(axis, geometry),
    )


def _former_key(axis: AxisConfig, geometry: AxisGeometry) -> str:
    """Return what states were bound to before they had a meaning: all of these, as they were."""
    signals = axis.model_dump(
        mode="json",
        include={"source", "nodes", "signals"},
        exclude={"nodes": {"set_position"}, "signals": {"set_position"}},
    )
    bound = {
        "type": "AxisPlan",
        "name": axis.name,
        "geometry": asdict(geometry),
        "memory_s": axis.memory_s,
        "meaning": json.dumps(signals, sort_keys=True),
        "feed_forward": None,
        "is_frozen": False,
        "has_speed": axis.nodes.speed is not None,
        "is_tracked": False,
    }
    return hashlib.sha256(json.dumps(bound, sort_keys=True).encode()).hexdigest()


def _meaning_of(config: Config, axis: AxisConfig) -> Meaning:
    """Return what an axis' signals mean: it is stored with the states learnt from them."""
    signals: dict[str, SignalMeaning] = {}
    for name in MEASURED:
        node: str | None = getattr(axis.nodes, name)
        if node is not None:
            scaling = axis.signals.measure(name).scaling(name)
            words = axis.signals.in_words(name)
            signals[name] = SignalMeaning(node, words, scaling.gain, scaling.offset)
    if axis.nodes.sequence is not None:
        signals["sequence"] = SignalMeaning(axis.nodes.sequence)
    return Meaning(config.source_of(axis).url, signals)


def axes_file(config: Config) -> Path:
    """Return the file of the axes' states, beside that of the valves'."""
    file = config.state.file
    return file.with_name(f"{file.stem}.axes{file.suffix}")
