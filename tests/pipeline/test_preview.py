"""A preview runs quick estimators; its successor repeats its calls and has the same state."""

import inspect
from typing import get_type_hints

import numpy as np
import pytest

from support.plant import as_changes, plant
from valvemap.errors import CommandRejected
from valvemap.model.flow_map import FlowMap
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.pipeline import call_journal
from valvemap.pipeline.alarm_results import Remark
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.operator_ports import Command
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.vocabulary.statuses import Status

# Methods without effect on the states: they read, log or compute tables from them.
READ = {
    "timing",
    "descriptions",
    "predict",
    "predict_measurement",
    "predict_approved",
    "invert",
    "compare",
    "baseline",
    "alarmed",
    "alarms",
    "repeat",
    "take_over",
}
# The same of its public parts.
READ_OF_PARTS = {
    "results": {"of", "one", "unknown", "recommendation", "counters", "waited_for"},
    "maps": {"refresh", "refresh_all"},
    "answers": {"required", "demands"},
    "armed": {"is_armed", "feed_forward"},
    "arrivals": {"waits", "pending"},
    "stamping": {"newly_found"},
    "plausibility": {"findings"},
    "valves": {"one_of_each_kind", "lane", "state"},
    "failures": {"take_new"},
    "states": {"kept", "checkpoints", "memories", "review"},
    "kept_columns": {"columns", "baselines"},
}


def valves(waits=None):
    estimators = {"RLS": RecursiveLeastSquares(), "Auto": FlowMap()}
    plans = [ValvePlan(name, QualityGate(), estimators, "Auto") for name in ("V", "W")]
    align = Alignment(AlignmentSettings(), optional=(("T",),) * 2, has_sequence=(True,) * 2)
    return Identification(plans, align, waits=waits)


def live(identification):
    """Calls of a start: samples, commands, a rejected command, a restart of the source."""
    changes = as_changes(plant(90))
    identification.was_away()
    identification.take(changes[:100])
    identification.do(Command.of("set_forgetting_factor", "V", "Auto", 0.99))
    identification.do(Command.of("freeze", "V", "RLS"))
    with pytest.raises(CommandRejected):
        identification.do(Command.of("set_forgetting_factor", "V", "RLS", 7.0))
    identification.take(changes[100:400])
    identification.do(Command.of("resume", "V", "RLS"))
    identification.do(Command.of("demand", "V", 30.0, 50.0))
    identification.say_overdue(np.array([1]), np.array([plant(1).t[0]] * 2)[:1] + 10**10)
    remark = Remark("cable", "operator", 1)
    identification.do(Command.of("remark", "W", "SensorLost", remark))
    identification.take(changes[400:])
    identification.begin_source_anew(np.array([0]), 1)


def bits(identification):
    return {
        (columns.key, name): array.tobytes()
        for columns in identification.kept_columns.columns()
        for name, array in columns.arrays.items()
    }


def methods_of(kind):
    return {name for name, _ in inspect.getmembers(kind, inspect.isfunction) if name[0] != "_"}


def test_a_method_either_reads_or_is_noted():
    public = {
        name: method
        for name, method in inspect.getmembers(Identification, inspect.isfunction)
        if not name.startswith("_")
    }
    noted = {name for name, method in public.items() if hasattr(method, "__wrapped__")}
    assert noted | READ == set(public)
    assert not noted & READ


def test_the_types_of_public_parts_let_callers_read_and_no_more():
    types = {part: methods_of(kind) for part, kind in get_type_hints(Identification).items()}
    assert types == READ_OF_PARTS
    identification = valves()
    public = {name for name in vars(identification) if not name.startswith("_")}
    assert public == {*READ_OF_PARTS, "journal", "changes", "plans"}


def test_an_estimator_that_waits_has_no_result_while_the_others_run():
    preview = valves(waits=["Auto"])
    preview.take(as_changes(plant(90)))
    result = preview.results.one(0).estimators
    assert (result["RLS"].sample_count, result["Auto"].sample_count) == (90, 0)
    assert result["Auto"].status is Status.WARMING_UP
    assert np.isnan(result["Auto"].predicted)
    preview.maps.refresh_all()
    assert not preview.failures.take_new()


def test_the_successor_has_the_bits_of_one_that_was_there_from_the_start():
    preview, successor, undisturbed = valves(waits=["Auto"]), valves(), valves()
    live(preview)
    live(undisturbed)
    successor.repeat(preview.journal.take_new())
    preview.take_over(successor)
    assert bits(preview) == bits(undisturbed)
    assert preview.journal is None
    assert preview.results.one(0).estimators["Auto"].sample_count == 90


def test_alarms_of_the_successor_count_as_new():
    preview, successor = valves(waits=["Auto"]), valves()
    live(preview)
    before = next(preview.results.of([0, 1])).alarms.version
    successor.repeat(preview.journal.take_new())
    preview.take_over(successor)
    after = next(preview.results.of([0, 1])).alarms.version
    assert (after != before).all()


def test_no_version_of_a_preview_is_one_of_its_successor():
    preview, successor = valves(waits=["Auto"]), valves()
    live(preview)
    before = preview.version
    successor.repeat(preview.journal.take_new())
    preview.take_over(successor)
    assert preview.version[0] > before[0]


def test_without_waiting_estimators_nothing_is_noted():
    assert valves().journal is None


def test_a_journal_is_full_at_its_bound(monkeypatch):
    monkeypatch.setattr(call_journal, "MOST", 500)
    preview = valves(waits=["Auto"])
    changes = as_changes(plant(90))
    preview.take(changes[:400])
    assert not preview.journal.is_full
    preview.take(changes[400:])
    assert preview.journal.is_full
    assert len(preview.journal.take_new()) == 2
    assert not preview.journal.is_full
