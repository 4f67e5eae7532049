"""Valves with ports: four edges and two leakages from two lines' flows."""

from itertools import pairwise

import numpy as np
import pytest

from support import ports
from support.soaked import soaked
from valvemap.app.build import build_identification
from valvemap.config.loading import load_config
from valvemap.opcua_source.source_nodes import ValveNodes, copies_of
from valvemap.opcua_source.source_units import Scales
from valvemap.pipeline.edges import MOST_WAITING, NEVER_MET, matched
from valvemap.pipeline.operator_ports import Command
from valvemap.vocabulary.signals import PUBLISHED
from valvemap.vocabulary.statuses import LineEdge, Quality, Status

EDGES = ("PA", "AT", "PB", "BT")


@pytest.fixture
def config(tmp_path):
    file = tmp_path / "ports.toml"
    file.write_text("[alignment]\nfind_timing = false\n" + ports.toml())
    return load_config(file)


def learnt(config, recorded, cuts=()):
    identification = build_identification(config)
    feed(identification, config, recorded, cuts)
    return identification


def feed(identification, config, recorded, cuts=()):
    changes = ports.changes_of(config, recorded)
    ends = [0, *cuts, len(changes)]
    for first, last in pairwise(ends):
        identification.take(changes[first:last])


def states(identification):
    return {(c.valve, c.estimator): c.state for c in identification.states.kept()}


def test_each_edge_and_the_leakage_are_right(config):
    identification = learnt(config, ports.recording())
    for edge in EDGES:
        for U, dp in ((30.0, 40.0), (80.0, 90.0)):
            Q, _, status = identification.predict(f"V.{edge}", "RLS", U, dp, 40.0)
            assert pytest.approx(ports.flow(edge, U, dp), abs=3.5) == Q
            assert status == Status.OK
    for line, sign in (("LineA", 1.0), ("LineB", 1.0)):
        lane = identification.valves.lane(f"V.{line}", "Leak")
        (c,), (std,) = lane.estimator.parameters(lane.state)
        assert sign * c == pytest.approx(ports.LEAKAGE, rel=0.05)
        assert abs(c - ports.LEAKAGE) < 4.0 * std
        assert std < 0.1 * ports.LEAKAGE


def test_leakage_is_not_taken_for_flow(config):
    """Without the leakage subtracted, a flow at small openings is off by more than this."""
    identification = learnt(config, ports.recording(seconds=60.0, sigma=0.01))
    residuals = [identification.valves.lane(f"V.{edge}", "RLS").score.rmse for edge in EDGES]
    without = ports.recording(seconds=60.0, sigma=0.01)
    lost = ports.LEAKAGE * (without["pA"] - without["pB"])
    without["QA"] += lost
    without["QB"] -= lost
    alone = learnt(config, without)
    for own, edge in zip(residuals, EDGES, strict=True):
        assert own < 1.15 * alone.valves.lane(f"V.{edge}", "RLS").score.rmse


def test_any_cut_of_the_stream_gives_the_same_bits(config):
    recorded = ports.recording(seconds=12.0)
    whole = states(learnt(config, recorded))
    rng = np.random.default_rng(5)
    n = len(ports.changes_of(config, recorded))
    for pieces in (7, 60):
        cuts = np.sort(rng.integers(1, n, pieces)).tolist()
        assert states(learnt(config, recorded, cuts)) == whole


def test_a_restored_state_goes_on_as_if_nothing_had_happened(config):
    recorded = ports.recording(seconds=12.0)
    changes = ports.changes_of(config, recorded)
    whole = learnt(config, recorded)
    at = len(changes) // 2 + 17  # within a sample: something waits of each edge
    first = build_identification(config)
    first.take(changes[:at])
    second = build_identification(config)
    restored, refused = second.restore(second.states.review(first.states.kept()).checkpoints)
    assert not refused
    assert "V.PA.Edge" in restored
    second.take(changes[at:])
    assert states(second) == states(whole)


def test_a_closed_edge_shows_no_flow_and_learns_nothing(config):
    recorded = ports.recording(seconds=10.0)
    recorded["U"] = np.abs(recorded["U"])
    identification = learnt(config, recorded)
    numbers = {plan.name: n for n, plan in enumerate(identification.plans)}
    (results,) = identification.results.of([numbers["V.AT"]])
    values = results.signals.values[0]
    assert (values[0], values[3]) == (0.0, 0.0)
    assert results.signals.quality[0] == Quality.GOOD
    assert identification.valves.lane("V.AT", "RLS").count == 0
    assert identification.valves.lane("V.PA", "RLS").count > 500


@pytest.mark.parametrize("seconds", [10.0, *soaked(20.0)])
@pytest.mark.parametrize("cut", [7, 10**6, *soaked(1, 700)])
def test_an_edge_that_is_closed_for_long_has_lost_no_sensor(config, cut, seconds):
    recorded = ports.recording(seconds)
    far = np.abs(recorded["U"]) + 10.0
    recorded["U"] = np.where(recorded["t"] % 8.0 < 4.0, far, -far)  # each edge is closed for 4 s
    changes = ports.changes_of(config, recorded)
    names = [f"V.{edge}" for edge in EDGES]
    identification = build_identification(config)
    seen = set()
    step = cut * 48  # changes of a sample
    for first in range(0, len(changes), step):
        identification.take(changes[first : first + step])
        seen |= {
            (name, report.name)
            for name in names
            for report in identification.alarms(name)
            if not report.acked
        }
    assert not {name for name, alarm in seen if alarm == "SensorLost"}


def test_an_edge_whose_sensor_was_away_has_lost_it(config):
    recorded = ports.recording(seconds=20.0)
    recorded["U"] = np.abs(recorded["U"]) + 10.0  # always open
    recorded["pP"] = np.where(np.abs(recorded["t"] - 10.0) < 2.0, np.nan, recorded["pP"])
    identification = learnt(config, recorded)
    lost = {r.name for r in identification.alarms("V.PA") if not r.acked}
    assert "SensorLost" in lost
    lost = {r.name for r in identification.alarms("V.BT") if not r.acked}
    assert "SensorLost" not in lost


def test_an_edge_that_is_frozen_leaves_the_others_their_bits(config):
    recorded = ports.recording(seconds=10.0)
    whole = states(learnt(config, recorded))
    identification = build_identification(config)
    identification.do(Command.of("freeze", "V.PA", "RLS"))
    feed(identification, config, recorded)
    found = states(identification)
    for key, state in whole.items():
        if key[0] != "V.PA":
            assert found[key] == state, key


def test_an_error_at_one_edge_stops_that_edge_alone(config, monkeypatch):
    recorded = ports.recording(seconds=10.0)
    whole = states(learnt(config, recorded))
    identification = build_identification(config)
    split = identification._parts.intake.splitter._of_edge
    bad = [plan.name for plan in identification.plans].index("V.PB")

    def raising(number):
        if number == bad:
            raise ZeroDivisionError
        return split(number)

    monkeypatch.setattr(identification._parts.intake.splitter, "_of_edge", raising)
    feed(identification, config, recorded)
    assert {failure.valve for failure in identification.failures.take_new()} == {"V.PB"}
    found = states(identification)
    for key, state in whole.items():
        if key[0] != "V.PB":
            assert found[key] == state, key


def test_what_waits_is_bounded_and_its_loss_counted(config):
    recorded = ports.recording(seconds=60.0)
    changes = ports.changes_of(config, recorded, left_out={("V.LineA", "p2")})
    identification = build_identification(config)
    identification.take(changes)
    numbers = {plan.name: n for n, plan in enumerate(identification.plans)}
    assert identification.results.counters(numbers["V.PA"])["missing"] == 6_000 - MOST_WAITING
    assert identification.valves.lane("V.PA", "RLS").count == 0
    assert identification.valves.lane("V.PB", "RLS").count > 500


def test_a_line_answers_with_the_edge_that_the_sign_selects(config):
    identification = learnt(config, ports.recording())
    numbers = {plan.name: n for n, plan in enumerate(identification.plans)}
    for line, edges in (("A", ("PA", "AT")), ("B", ("PB", "BT"))):
        name = f"V.Line{line}"
        for Q in (-40.0, -5.0, 5.0, 40.0):
            identification.do(Command.of("demand", name, Q, np.nan))
            (results,) = identification.results.of([numbers[name]])
            edge = edges[0] if Q > 0 else edges[1]
            assert LineEdge(int(results.lines.edge[0])).name == edge
            U = results.inverse.required_U[0]
            opens = 1.0 if edge in ("PA", "BT") else -1.0
            assert U * opens > 0
            assert results.inverse.lower[0] <= U <= results.inverse.upper[0]
            (signals,) = identification.results.of([numbers[f"V.{edge}"]])
            dp = signals.signals.values[0][PUBLISHED.index("dp")]
            flow, std, _ = identification.predict(f"V.{edge}", "RLS", abs(U), dp, 40.0)
            sign = 1.0 if Q > 0 else -1.0
            lost = results.lines.leakage[0] * results.signals.values[0][PUBLISHED.index("dp")]
            assert flow == pytest.approx(sign * (Q + lost), abs=0.1 + std)


def test_a_demand_below_the_leakage_is_not_passed_to_the_other_edge(config):
    identification = learnt(config, ports.recording())
    answer = identification.invert("V.LineA", -1e-6, 50.0, 40.0)
    assert answer.U[0] <= 0.0
    assert identification.invert("V.LineA", np.nan, 50.0, 40.0).status[0] == 5
    assert identification.invert("V.LineA", 0.0, 50.0, 40.0).U[0] == 0.0


def test_a_node_that_several_items_share_is_monitored_once_and_reaches_all(config):
    valves = [ValveNodes(valve=v.name, **v.nodes.model_dump()) for v in config.valves]
    copies = copies_of(valves)
    assert len(copies) == len(ports.NODES)
    changes = ports.changes_of(config, ports.recording(seconds=0.1), slice(0, 3))
    primary = np.isin(changes.item, list(copies))
    spread = Scales(valves)(changes[primary])
    order = np.lexsort((spread.item, spread.source_time))
    wanted = np.lexsort((changes.item, changes.source_time))
    for name in ("item", "value", "source_time"):
        assert (getattr(spread, name)[order] == getattr(changes, name)[wanted]).all(), name


@pytest.mark.parametrize("lacks", [0, 1, 2])
@pytest.mark.parametrize("cut", [1, 3, 100])
def test_a_sample_that_one_row_lacks_before_a_step_back_costs_that_sample_alone(lacks, cut):
    hour = 3_600 * 10**9
    t = np.concatenate([np.arange(10), np.arange(10) + 11 - hour, np.arange(10) + 30])
    streams = [t if k != lacks else np.delete(t, [9, 20]) for k in range(3)]
    waiting, last, met = [t[:0]] * 3, np.array([NEVER_MET]), []
    for first in range(0, len(t), cut):
        waiting = [
            np.concatenate([one, new[first : first + cut]])
            for one, new in zip(waiting, streams, strict=True)
        ]
        rows, past = matched(waiting, last, MOST_WAITING)
        met += waiting[0][rows[0]].tolist()
        waiting = [one[first:] for one, first in zip(waiting, past, strict=True)]
    assert met == np.delete(t, [9, 20]).tolist()
