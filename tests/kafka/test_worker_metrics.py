"""A worker's metrics: of its groups alone, equal to its results, and of no effect on them."""

import json

import numpy as np
import pytest

pytest.importorskip("pyarrow")

from support.exposition import names, parsed, promtool_accepts, value
from support.fleet import RHYTHM, Dictionary, as_messages, catalogue, day
from valvemap.clock import ManualClock
from valvemap.kafka.client_statistics import read_statistics
from valvemap.kafka.worker import Worker
from valvemap.kafka.worker_metrics import WorkerMetrics
from valvemap.page.exposition import exposition
from valvemap.vocabulary.fleet_series import OF_WORKER

GROUPS = ("north.0", "north.1")
TOPIC, STATES = "valvemap.samples", "valvemap.state"
TOPICS = (TOPIC, "valvemap.commands")


@pytest.fixture(scope="module")
def known():
    return catalogue()


def statistics(lags, topic=TOPIC):
    partitions = {
        str(p): {"desired": True, "ls_offset": 10, "app_offset": 10 - lag, "fetchq_cnt": 2}
        for p, lag in lags.items()
    }
    partitions["-1"] = {"desired": False, "ls_offset": -1001, "app_offset": -1001}
    topics = {topic: {"partitions": partitions}, STATES: {"partitions": partitions}}
    return json.dumps({"msg_cnt": 4, "topics": topics})


def fed(known, metrics):
    """What a worker publishes of two groups, each in a partition of its own."""
    worker, out = Worker(known, RHYTHM, metrics=metrics), []
    for k, name in enumerate(GROUPS):
        store = Dictionary()
        for kind, key, packed in as_messages(day(known.groups[name], seed=k)):
            take = worker.samples if kind == "samples" else worker.command
            out += take(key, packed, store)
            if metrics is not None:
                metrics.note_message(kind, key, k)
    return worker, out


def text_of(metrics):
    return exposition(metrics.points()).decode()


def test_every_series_is_there_and_promtool_accepts_them(known):
    metrics = WorkerMetrics(TOPICS)
    fed(known, metrics)
    metrics.note_consumer(statistics({0: 7, 1: 0}))
    metrics.note_producer(statistics({}))
    text = text_of(metrics)
    apart = {"valvemap_build_info", "valvemap_exporter_refused_total"}  # the exporter's own
    alarms = {name for name in names(text) if "alarm" in name}
    expected = {one.shown for one in OF_WORKER if "alarm" not in one.name} - apart
    assert names(text) - alarms == expected
    promtool_accepts(text)
    assert value(text, "valvemap_worker_lag_messages", topic=TOPIC, partition="0") == 7
    assert value(text, "valvemap_worker_unsent_messages") == 4
    assert STATES not in text


def test_estimators_and_alarms_are_those_of_the_results(known):
    metrics = WorkerMetrics(TOPICS)
    worker, _ = fed(known, metrics)
    text = text_of(metrics)
    for name in GROUPS:
        whole = worker._held[name].group.identification
        for results in whole.results.of(range(len(whole.plans))):
            for m, number in enumerate(results.valves.tolist()):
                valve = whole.plans[number].name
                for estimator, found in results.estimators.items():
                    labels = {"valve": valve, "estimator": estimator}
                    shown = value(text, "valvemap_estimator_samples_total", **labels)
                    assert shown == found.sample_count[m]
                reports = {r.name: r for r in results.alarms.reports(m)}
                shown = {
                    dict(labels)["alarm"]
                    for one, labels in parsed(text)
                    if one == "valvemap_alarm_severity" and dict(labels)["source"] == valve
                }
                wait = {
                    r.name for r in reports.values() if r.active or not (r.acked and r.confirmed)
                }
                assert shown == wait


def test_the_results_are_the_same_bits_with_and_without_metrics(known):
    assert fed(known, WorkerMetrics(TOPICS))[1] == fed(known, None)[1]


def test_foreign_messages_add_no_series(known):
    metrics = WorkerMetrics(TOPICS)
    worker = Worker(known, RHYTHM, metrics=metrics)
    before = len(parsed(text_of(metrics)))
    rng = np.random.default_rng(1)
    for k in range(1_000):
        key = rng.bytes(20) if k % 2 else f"south.{k}".encode()
        worker.samples(key, rng.bytes(50), Dictionary())
        worker.rejected()
        metrics.note_message("samples", key, k)
    text = text_of(metrics)
    assert len(parsed(text)) == before
    assert value(text, "valvemap_worker_rejected_messages_total") == 1_000
    assert value(text, "valvemap_worker_messages_total", kind="samples") == 1_000


def test_a_group_that_went_to_another_worker_has_no_series_here(known):
    metrics = WorkerMetrics(TOPICS)
    fed(known, metrics)

    def groups():
        return {
            dict(labels)["group"] for name, labels in parsed(text_of(metrics)) if "group" in name
        }

    assert groups() == set(GROUPS)
    metrics.note_consumer(statistics({1: 0}))
    assert groups() == {"north.1"}
    metrics.note_restart()
    assert groups() == set()
    metrics.note_consumer(statistics({0: 0, 1: 0}))
    assert groups() == set(GROUPS)


def test_results_whose_metrics_fail_are_counted_and_published(known, monkeypatch):
    def fails(*_):
        raise ZeroDivisionError

    metrics = WorkerMetrics(TOPICS)
    monkeypatch.setattr(metrics, "_note_results", fails)
    _, out = fed(known, metrics)
    assert out == fed(known, None)[1]
    assert value(text_of(metrics), "valvemap_worker_unshown_results_total") > 10


def test_the_age_of_a_commit_and_of_samples_grows(known):
    clock = ManualClock()
    metrics = WorkerMetrics(TOPICS, clock)
    fed(known, metrics)
    metrics.note_commit()
    before = text_of(metrics)
    clock.advance(3.0)
    after = text_of(metrics)
    for name, labels in (
        ("valvemap_worker_commit_age_seconds", {}),
        ("valvemap_group_sample_age_seconds", {"group": "north.0"}),
    ):
        grown = value(after, name, **labels) - value(before, name, **labels)
        assert grown == pytest.approx(3.0, abs=1e-3)


def test_the_lag_is_known_before_the_first_message_and_unknown_without_an_end():
    def lag(**more):
        one = {"desired": True, "fetchq_cnt": 0, **more}
        said = {"topics": {"t": {"partitions": {"0": one}}}}
        return read_statistics(json.dumps(said)).lag["t", "0"]

    assert lag(ls_offset=9, app_offset=-1001, next_offset=4) == 5
    assert lag(ls_offset=9, app_offset=12) == 0
    assert np.isnan(lag(ls_offset=-1001, app_offset=-1001, next_offset=-1001))
    assert np.isnan(lag(ls_offset=True, app_offset="4"))


@pytest.mark.parametrize(
    "packed",
    [
        *("", "[]", "null", "{", '{"topics": 5}', '{"topics": {"t": []}}', "[" * 100_000),
        '{"topics": {"t": {"partitions": {"0": 7, "x": {"desired": true}}}}}',
    ],
)
def test_statistics_of_another_version_are_left_out(packed):
    found = read_statistics(packed)
    assert (found.lag, found.fetched) == ({}, {})
