from pathlib import Path

import pytest

from valvemap.app.build import build_plans
from valvemap.config.loading import load_config
from valvemap.config.models import Config
from valvemap.config.mqtt import MqttConfig
from valvemap.errors import ConfigurationError
from valvemap.kafka.settings import FleetConfig
from valvemap.model.sensor_accuracy import SensorAccuracy
from valvemap.vocabulary.commands import BY_MQTT

NODES = "[valves.nodes]\nU = 's=U'\np1 = 's=p1'\np2 = 's=p2'\nQ = 's=Q'\n"
COMMANDED = "required_U = 's=C'\nheartbeat = 's=B'\n"
DRIVEN = f"[[valves]]\n{NODES}{COMMANDED}[valves.commission]\n"
LOADED = f"[[valves]]\n{NODES}{COMMANDED}load = 's=L'\n[valves.commission]\n"
FED = f"[[valves]]\n{NODES}required_U = 's=C'\n[valves.feed_forward]\n"


def write(tmp_path, text):
    file = tmp_path / "service.toml"
    file.write_text(text, encoding="utf-8")
    return file


def complaint(tmp_path, text):
    with pytest.raises(ConfigurationError) as caught:
        load_config(write(tmp_path, text))
    return str(caught.value)


def test_without_a_file_the_defaults_fit_the_virtual_rig():
    (valve,) = load_config().valves
    assert valve.name == "Valvistor"
    assert valve.nodes.T == "nsu=urn:valvemap:rig;s=Valvistor.Temperature"
    assert [e.name for e in valve.estimators][:3] == ["RLS", "RML", "RBF"]


def test_a_named_valve_without_nodes_is_looked_for_under_its_name(tmp_path):
    config = load_config(write(tmp_path, '[[valves]]\nname = "Boom"\n'))
    assert config.valves[0].nodes.U == "nsu=urn:valvemap:rig;s=Boom.U"


def test_a_network_alone_may_be_given_both_edges_of_a_valve(tmp_path):
    text = "[[valves]]\nU_range_percent = [-100, 100]\n[[valves.estimators]]\nkind = 'RBF'\n"
    assert load_config(write(tmp_path, text)).valves[0].U_range_percent == (-100.0, 100.0)


def test_the_accuracy_of_a_sensor_is_stated_in_its_own_unit(tmp_path):
    text = "[[valves]]\n[valves.signals]\np1 = { unit = 'psi', accuracy = 15 }\n"
    text += "T = { unit = '°F', accuracy = 9 }\n"
    (plan,) = build_plans(load_config(write(tmp_path, text)))
    assert plan.accuracy == SensorAccuracy(p1=pytest.approx(1.0342136), T=pytest.approx(5.0))
    below = text.replace("15", "-15")
    assert "accuracy" in complaint(tmp_path, below)


@pytest.mark.parametrize("file", [Config, FleetConfig])
def test_every_number_has_both_ends(file):
    schema = file.model_json_schema()
    boundless = []

    def look_into(part, path):
        if part.get("type") in ("number", "integer"):
            low = {"minimum", "exclusiveMinimum"} & part.keys()
            high = {"maximum", "exclusiveMaximum"} & part.keys()
            boundless.extend([] if low and high else [path])
        for key, inner in part.items():
            for one in inner if isinstance(inner, list) else [inner]:
                if isinstance(one, dict):
                    look_into(one, f"{path}.{key}")

    look_into(schema, file.__name__)
    assert boundless == []


@pytest.mark.parametrize("most", ["1e30", "1e300"])
def test_a_time_beyond_what_nanoseconds_hold_is_refused(tmp_path, most):
    text = f"[[valves]]\n[valves.gate.Q]\nfrozen_s = {most}\n"
    assert "frozen_s" in complaint(tmp_path, text)
    assert "less than or equal to 1000000000" in complaint(tmp_path, text)


def test_a_long_value_is_named_by_its_beginning(tmp_path):
    assert len(complaint(tmp_path, f"[source]\nurl = '{'x' * 9_000}'\n")) < 500


def test_the_environment_overrides_the_file(tmp_path, monkeypatch):
    monkeypatch.setenv("VALVEMAP_SOURCE__URL", "opc.tcp://plc:4840")
    monkeypatch.setenv("VALVEMAP_SOURCE__PASSWORD", "geheim")
    config = load_config(write(tmp_path, '[source]\nurl = "opc.tcp://other:1"\nuser = "u"\n'))
    assert config.source.url == "opc.tcp://plc:4840"
    assert config.source.user == "u"
    assert "geheim" not in repr(config)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[source]\nspeed = 1\n", "source.speed: there is no such field"),
        ("[source]\nurl = 'http://x'\n", "source.url = 'http://x': "),
        ("[source]\nqueue_size = 0\n", "source.queue_size = 0: input should be greater than"),
        ("[[valves]]\nname = 'a b'\n", "valves[0].name = 'a b': "),
        ("[[valves]]\n[[valves]]\n", "valves: valve name 'Valvistor' is taken twice"),
        ("[[valves]]\ninverse = 'X'\n", "inverse = 'X': allowed is one of recommended, RLS, "),
        (
            "[[valves]]\n[[valves.estimators]]\nkind = 'RLS'\nlam = 1.5\n",
            "valves[0].estimators[0].lam = 1.5: input should be less than or equal to 1",
        ),
        ("[[valves]]\n[[valves.estimators]]\nkind = 'XYZ'\n", "XYZ"),
        ("[[valves]]\nestimators = []\n", "at least one is needed"),
        ("[[valves]]\n[valves.nodes]\nU = 'x'\n", "valves[0].nodes.U = 'x': a node id looks like"),
        ("[[valves]]\n[valves.gate.Q]\nlow = 5\nhigh = 1\n", "low 5 must be below high 1"),
        (
            FED + "range_percent = [90, 10]\n",
            "range_percent = [90, 10]: the first must be below the second",
        ),
        (FED + "range_percent = [0, 101]\n", "range_percent[1] = 101: input should be less than"),
        (FED + "slew_percent_per_s = 0\n", "slew_percent_per_s = 0: input should be greater"),
        (FED + "fallback = 'pray'\n", "fallback = 'pray': input should be 'hold', 'ramp' or"),
        (FED + "fallback = 'hand_back'\n", "fallback = 'hand_back': nodes.heartbeat is needed"),
        (
            FED + "fallback = 'ramp'\nrange_percent = [5, 95]\n",
            "fallback_percent = 0: must be within range_percent = [5.0, 95.0]",
        ),
        (
            "[[valves]]\n[valves.commission]\np1_range_bar = [150, 220]\np_most_bar = 100\n",
            "p_most_bar = 100: must exceed 150 of p1_range_bar = [150.0, 220.0]; the run ends",
        ),
        (
            "[[valves]]\n[valves.commission]\nload_range_bar = [5, 190]\np_most_bar = 180\n",
            "p_most_bar = 180: must exceed 190 of load_range_bar = [5.0, 190.0]",
        ),
        (
            "[[valves]]\n[valves.commission]\nlast_period_s = 21\n",
            "last_period_s = 21: must be 0, or between period_s = 4 and sweep_s - period_s = 20",
        ),
        (FED + "max_age_s = 0.1\n", "valves[0].feed_forward.max_age_s = 0.1: must be longer than"),
        (FED + "max_width_percent = nan\n", "valves[0].feed_forward.max_width_percent"),
        ("[[valves]]\n[valves.feed_forward]\n", "nodes.required_U is needed"),
        ("[[valves]]\n" + NODES + "heartbeat = 's=B'\n", "heartbeat: required_U is needed, too"),
        (
            f"[[valves]]\n{NODES}load = 's=L'\n",
            "load: heartbeat is needed, too; the source would keep the last load",
        ),
        (LOADED, "valves[0]: commission.load_range_bar is needed with nodes.load"),
        (LOADED + "load_range_bar = [10, 90]\n", "commission.safe_load_bar is needed with"),
        (
            LOADED + "load_range_bar = [10, 90]\nsafe_load_bar = 99\n",
            "commission.safe_load_bar = 99: must be within load_range_bar = [10.0, 90.0]",
        ),
        (DRIVEN + "safe_load_bar = 9\n", "commission.safe_load_bar: nodes.load is needed"),
        (
            "[[valves]]\nU_range_percent = [10, 90]\n[valves.commission]\nsafe_percent = 0\n",
            "commission.safe_percent = 0: must be within U_range_percent = [10.0, 90.0]",
        ),
        ("[[valves]]\n" + NODES + "T = 's=p1'\n", "p1 and T are the same node, 's=p1'"),
        (
            "[[valves]]\nU_range_percent = [-100, 100]\n",
            "valves[0].U_range_percent = [-100, 100]: more than RLS, RML can describe; with",
        ),
        ("[[valves]]\nU_range_percent = [0, 120]\n", "[0, 120]: more than RLS, RML can"),
        *(
            (
                f"[[valves]]\n[[valves.estimators]]\nkind = '{kind}'\nlam = 1e-300\n",
                f"lam = 1e-300: forgetting factor 1e-300: allowed is {least} <= lam <= 1",
            )
            for kind, least in (("RLS", 0.8333), ("RML", 0.5), ("Auto", 0.5))
        ),
        ("[source]\ntimeout_s = true\n", "source.timeout_s = True: true is no number"),
        ("[dynamics]\nshare = false\n", "dynamics.share = False: false is no number"),
        ("[[valves]]\ndp_range_bar = [true, 200]\n", "dp_range_bar = [True, 200]: true is no"),
        ("[state]\nfile = ''\n", "state.file = '': the name of a file or a folder is allowed"),
        ("[state]\nfile = '  '\n", "state.file = '  ': the name of a file or a folder is"),
        ('[history]\nfile = "a\\u0000"\n', "history.file = 'a\\x00': the name of a file or a"),
        (f"[security]\nusers = '{'x' * 5_000}'\n", "a name of 4095 bytes at most is allowed"),
        ("[source\n", "not valid TOML"),
        ("[source]\ntimeout_s = nan\n", "source.timeout_s"),
    ],
)
def test_a_mistake_is_one_line_that_names_file_field_and_value(tmp_path, text, said):
    message = complaint(tmp_path, text)
    assert message.startswith(str(tmp_path / "service.toml"))
    assert said in message
    assert "\n" not in message or "nodes]\nU = 'x'" in text


def test_a_mistake_in_the_environment_names_the_variable(monkeypatch):
    monkeypatch.setenv("VALVEMAP_SOURCE__QUEUE_SIZE", "many")
    with pytest.raises(ConfigurationError, match="VALVEMAP_SOURCE__QUEUE_SIZE"):
        load_config()


def test_an_editor_s_byte_order_mark_is_no_part_of_the_text(tmp_path):
    file = tmp_path / "service.toml"
    file.write_text("[[valves]]\nname = 'V7'\n", encoding="utf-8-sig")
    assert load_config(file).valves[0].name == "V7"


def test_a_field_that_stands_twice_is_not_asked_for_quotes(tmp_path):
    said = complaint(tmp_path, "[source]\nurl = 'opc.tcp://a:1'\nurl = 'opc.tcp://b:1'\n")
    assert "Cannot overwrite a value (at line 3" in said
    assert "quotes" not in said


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigurationError, match=r"none\.toml: no such file"):
        load_config(tmp_path / "none.toml")


@pytest.mark.parametrize("name", ["Signals", "Alarms", "Diagnostics", "Inverse"])
def test_an_estimator_may_not_be_called_as_another_node(tmp_path, name):
    file = tmp_path / "c.toml"
    file.write_text(f'[[valves]]\n[[valves.estimators]]\nkind = "RLS"\nname = "{name}"\n')
    with pytest.raises(ConfigurationError, match=f"'{name}' is taken"):
        load_config(file)


def test_a_valve_may_not_be_called_service(tmp_path):
    file = tmp_path / "c.toml"
    file.write_text('[[valves]]\nname = "Service"\n')
    with pytest.raises(ConfigurationError, match="'Service' is taken"):
        load_config(file)


TWO_SOURCES = (
    "[[sources]]\nname = 'north'\nurl = 'opc.tcp://n:1'\n"
    "[[sources]]\nname = 'south'\nurl = 'opc.tcp://s:1'\nsecurity = 'None'\n"
    "[[valves]]\nname = 'A'\nsource = 'south'\n[[valves]]\nname = 'B'\nsource = 'north'\n"
)


def test_each_valve_names_its_source(tmp_path):
    config = load_config(write(tmp_path, TWO_SOURCES))
    assert [config.source_of(valve).url for valve in config.valves] == [
        "opc.tcp://s:1",
        "opc.tcp://n:1",
    ]
    alone = config.only("south")
    assert (alone.source.url, alone.source.security) == ("opc.tcp://s:1", "None")
    assert [valve.name for valve in alone.valves] == ["A"]
    assert alone.valves[0].source is None


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("[[valves]]\nname = 'A'\nsource = 'south'\n", "[[valves]]\nname = 'A'\n", "is missing"),
        ("source = 'south'", "source = 'west'", "valves[0].source = 'west': allowed is one of"),
        ("source = 'south'", "source = 'north'", "source 'south' is named by no valve"),
        ("name = 'south'", "name = 'north'", "source name 'north' is taken twice"),
        ("[[sources]]\nname = 'north'", "[source]\n[[sources]]\nname = 'north'", "only one of"),
        ("name = 'south'\n", "", "name"),
    ],
)
def test_sources_that_do_not_fit_are_refused_in_a_line(tmp_path, before, after, said):
    assert before in TWO_SOURCES
    line = complaint(tmp_path, TWO_SOURCES.replace(before, after, 1))
    assert said in line
    assert len(line.splitlines()) == 1


def test_a_source_named_without_sources_is_refused(tmp_path):
    assert "there are no [[sources]]" in complaint(tmp_path, "[[valves]]\nsource = 'x'\n")


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ('broker = "broker.plant:1883"', "mqtt.broker = 'broker.plant:1883': allowed is mqtt://"),
        ('broker = "mqtt://a:b@host"', "mqtt.broker = 'mqtt://***@host': allowed is mqtt://"),
        ('broker = "mqtt://host:70000"', "its port must be 1 to 65535"),
        ('group = "a/b"', "mqtt.group = 'a/b': allowed are words without / + #"),
        ('edge_node = ""', "mqtt.edge_node = '': allowed are words"),
        ('user = "u"', "user and password_file belong together"),
        ('broker = "mqtts://h"\ncertificate_file = "c"', "certificate_file and key_file belong"),
        ('ca_file = "c"', "ca_file and certificate_file need broker = mqtts://"),
        ('broker = "mqtt://h"\nuser = "u"\npassword_file = "p"', "mqtts:// is needed"),
        ("variables = []", "mqtt.variables"),
        ('structure = "udt"', "mqtt.structure = 'udt': input should be 'flat' or 'templates'"),
        ('commands = ["arm"]', "mqtt.commands[0] = 'arm': input should be 'demand' or"),
        ('commands = ["demand"]', "commands need user and password_file, or certificate_file"),
        ('broker = "mqtts://h"\ncommands = ["demand"]', "commands need user and password_file"),
        ("command_max_age_s = 0", "mqtt.command_max_age_s = 0: input should be"),
        ("interval = 1", "mqtt.interval: there is no such field; is interval_s meant?"),
    ],
)
def test_a_mistake_in_mqtt_is_one_line_that_says_what_is_allowed(tmp_path, section, said):
    line = complaint(tmp_path, f"[mqtt]\n{section}\n")
    assert len(line.splitlines()) == 1
    assert said in line


def test_commands_need_a_log_in_at_the_broker_and_tls_unless_it_is_on_this_machine():
    allowed = {"commands": ("demand", "acknowledge")}
    of = {"user": "u", "password_file": Path("p"), **allowed}
    assert MqttConfig().commands == ()
    assert MqttConfig(broker="mqtts://h", **of).commands == BY_MQTT
    assert MqttConfig(broker="mqtt://127.0.0.1", **of).commands == BY_MQTT
    files = {"certificate_file": Path("c"), "key_file": Path("k")}
    assert MqttConfig(broker="mqtts://h", **files, **allowed).commands == BY_MQTT


def test_a_password_may_travel_in_the_clear_on_this_machine_alone():
    of = {"user": "u", "password_file": Path("p")}
    assert MqttConfig(broker="mqtt://127.0.0.1:1883", **of).address == ("127.0.0.1", 1883)
    assert MqttConfig(broker="mqtts://[2001:db8::1]", **of).address == ("2001:db8::1", 8883)
