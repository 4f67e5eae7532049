"""Axes: what is read of a file, and what is refused."""

import pytest

from support.processes import run
from valvemap.app.axes import plan_of
from valvemap.app.build import feed_forward_of
from valvemap.app.connections import _of_axes
from valvemap.app.replay import replay
from valvemap.config.loading import load_config
from valvemap.errors import ConfigurationError
from valvemap.kafka.catalogue import catalogue_of

NODES = {name: f"ns=2;s=X.{name}" for name in ("U", "position", "pA", "pB", "pS", "pT")}


def toml(*, nodes=NODES, own="", more=""):
    lines = "\n".join(f'{name} = "{node}"' for name, node in nodes.items())
    sizes = "piston_mm = 63\nrod_mm = 45\nstroke_mm = 800\ndead_A_l = 1.2"
    return f'[[axes]]\nname = "Press"\n{sizes}\n{own}\n[axes.nodes]\n{lines}\n{more}\n'


def load(tmp_path, text):
    file = tmp_path / "service.toml"
    file.write_text(text, encoding="utf-8")
    return load_config(file)


def test_an_axis_alone_needs_no_valve(tmp_path):
    config = load(tmp_path, toml())
    assert (len(config.valves), config.axes[0].name) == (0, "Press")
    geometry = plan_of(config, config.axes[0]).geometry
    assert (geometry.dead_A_l, geometry.dead_B_l) == (1.2, 1.2)


def test_axes_and_valves_stand_beside_each_other(tmp_path):
    config = load(tmp_path, toml() + '[[valves]]\nname = "V1"\n')
    assert [one.name for one in (*config.valves, *config.axes)] == ["V1", "Press"]


def test_position_is_in_mm_unless_a_unit_is_given(tmp_path):
    (axis,) = load(tmp_path, toml()).axes
    assert axis.signals.measure("position").unit.symbol == "mm"
    (axis,) = load(tmp_path, toml(more='[axes.signals.position]\nunit = "m"')).axes
    assert axis.signals.measure("position").scaling("Q").gain == 1000.0


OF_SPEED = {name: node for name, node in NODES.items() if name != "position"} | {
    "speed": "ns=2;s=v"
}


def test_a_speed_stands_in_place_of_the_position(tmp_path):
    more = '[axes.signals.speed]\nunit = "m/s"'
    config = load(tmp_path, toml(nodes=OF_SPEED, more=more))
    assert plan_of(config, config.axes[0]).has_speed
    line_A, line_B = (nodes for _, nodes in _of_axes(config))
    assert (line_A.Q, line_B.Q) == ("ns=2;s=v", "ns=2;s=v")
    assert line_A.measures["Q"].scaling("Q").gain == 1000.0


WRITTEN = NODES | {"required_U": "ns=2;s=UCommand"}


def test_a_command_of_an_axis_has_both_signs(tmp_path):
    (axis,) = load(tmp_path, toml(nodes=WRITTEN)).axes
    given = feed_forward_of(axis)
    assert given.U_range == (-100.0, 100.0)
    assert not given.has_heartbeat
    (axis,) = load(tmp_path, toml()).axes
    assert feed_forward_of(axis) is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            toml(nodes={k: v for k, v in NODES.items() if k != "pB"}),
            "pB missing: each edge needs the pressures on both its sides",
        ),
        (
            toml(nodes={k: NODES[k] for k in ("U", "position")}),
            "pA, pB, pS and pT are missing: position and command do not tell the flows",
        ),
        (toml(nodes=NODES | {"speed": "ns=2;s=v"}), "position, speed: both are given; one of them"),
        (
            toml(nodes=OF_SPEED | {"set_position": "ns=2;s=xSet"}),
            "set_position: position is needed, too",
        ),
        (
            toml(nodes={k: v for k, v in NODES.items() if k != "position"}),
            "position, speed: both are missing; one of them is needed",
        ),
        (toml(nodes=NODES | {"pB": NODES["pA"]}), "pA and pB are the same node"),
        (toml(own="rod_mm = 70").replace("rod_mm = 45\n", ""), "rod_mm = 70: must be less than 63"),
        (toml(more='[axes.signals.position]\nunit = "bar"'), "a unit of length is needed"),
        (toml() + '[[valves]]\nname = "Press"\n', "axis name 'Press' is taken twice"),
        (toml(own='source = "north"'), "axes[0].source = 'north': there are no [[sources]]"),
        (toml().replace("Press", "Service"), "axis name 'Service' is taken"),
        (toml(nodes=NODES | {"heartbeat": "ns=2;s=H"}), "heartbeat: required_U is needed, too"),
        (toml(more="[axes.feed_forward]"), "feed_forward: nodes.required_U is needed"),
        (
            toml(nodes=WRITTEN, more='[axes.feed_forward]\nfallback = "hand_back"'),
            "feed_forward.fallback = 'hand_back': nodes.heartbeat is needed",
        ),
        (
            toml(nodes=WRITTEN, more="[axes.feed_forward]\nmax_age_s = 0.05"),
            "axes[0].feed_forward.max_age_s = 0.05: must be longer than",
        ),
        (
            toml(nodes=WRITTEN, more="[axes.signals.U]\nraw = [-10, 10]\nrange = [-100, 100]"),
            "signals.required_U: unit, or raw and range, must say",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path, text, words):
    with pytest.raises(ConfigurationError) as caught:
        load(tmp_path, text)
    assert words in str(caught.value)


def test_what_is_of_valves_alone_says_so(tmp_path):
    config = load(tmp_path, toml())
    with pytest.raises(ConfigurationError, match="there are axes and no valve: a replay is of"):
        replay([], config)
    with pytest.raises(ConfigurationError, match="site north: axis Press: a fleet takes valves"):
        catalogue_of({"north": config})


def test_check_config_names_the_axis(tmp_path):
    load(tmp_path, toml())
    said = run("check-config", str(tmp_path / "service.toml"))
    assert said.returncode == 0, said.stderr
    assert "axis     Press: four edges, bulk modulus and leakage" in said.stdout
