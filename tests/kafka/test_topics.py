"""Settings of a fleet, and topics that are as they say or are named."""

from pathlib import Path

import pytest

pytest.importorskip("confluent_kafka")

from valvemap.cli import run
from valvemap.errors import ConfigurationError
from valvemap.kafka.broker import client_settings
from valvemap.kafka.settings import BrokerConfig, FleetConfig, TopicsConfig, load_fleet
from valvemap.kafka.topics import Topic, contradictions, wanted

ROOT = Path(__file__).parents[2]


def test_the_shipped_configuration_says_what_would_hold_without_it():
    found = load_fleet(ROOT / "config" / "fleet.toml")
    assert found.topics == TopicsConfig()
    assert found.broker == BrokerConfig()
    assert found.work == FleetConfig().work
    assert found.catalogue.sites == {"demo": ROOT / "config" / "service.toml"}


def test_every_field_stands_in_the_documentation():
    text = (ROOT / "docs" / "fleet.md").read_text(encoding="utf-8")
    for section, field in FleetConfig.model_fields.items():
        for name, one in field.annotation.model_fields.items():
            assert one.description, name
            assert f"| `{section}.{name}` |" in text


def test_the_environment_overrides_the_file(tmp_path, monkeypatch):
    file = tmp_path / "fleet.toml"
    file.write_text("[topics]\npartitions = 6\n", encoding="utf-8")
    monkeypatch.setenv("VALVEMAP_FLEET_TOPICS__PARTITIONS", "7")
    assert load_fleet(file).topics.partitions == 7


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[topics]\npartitions = 0\n", "topics.partitions = 0: input should be greater than"),
        ("[topic]\n", "topic: there is no such field; is topics meant?"),
        ("[broker]\nuser = 'x'\n", "broker: user and password_file belong together"),
        ("[broker]\naddresses = []\n", "broker.addresses = []: "),
        ("[broker]\naddresses = ['k:1', 'k']\n", "broker.addresses[1] = 'k': "),
        (
            "[broker]\nuser = 'x'\npassword_file = 'p'\nmechanism = 'PLAIN'\n",
            'broker: mechanism = "PLAIN" shows the password to anyone: tls is needed',
        ),
        ("[catalogue]\nsites = { 'a b' = 'x.toml' }\n", "catalogue.sites.a b"),
    ],
)
def test_a_wrong_field_is_one_line(tmp_path, text, said):
    file = tmp_path / "fleet.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError) as refused:
        load_fleet(file)
    assert f"{file}: {said}" in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


def test_secrets_come_from_files_and_are_not_shown(tmp_path):
    password = tmp_path / "password"
    password.write_text("correct horse\n", encoding="utf-8")
    broker = BrokerConfig(user="valvemap", password_file=password, tls=True)
    said = client_settings(broker)
    assert said["security.protocol"] == "sasl_ssl"
    assert said["sasl.mechanism"] == "SCRAM-SHA-512"
    assert said["sasl.password"] == "correct horse"
    assert "horse" not in repr(broker)
    with pytest.raises(ConfigurationError, match=r"nowhere\.pem: no such file; broker\.ca_file"):
        client_settings(BrokerConfig(tls=True, ca_file=tmp_path / "nowhere.pem"))


def test_topics_that_meet_in_a_worker_have_equal_partitions():
    topics = wanted(TopicsConfig(prefix="plant", partitions=5, replication=1))
    assert [topic.name for topic in topics] == [
        "plant.samples",
        "plant.commands",
        "plant.results",
        "plant.rejected",
        "plant.state",
    ]
    assert {topic.partitions for topic in topics} == {5}
    assert topics[-1].settings["cleanup.policy"] == "compact"
    assert "retention.ms" not in topics[-1].settings


def test_each_contradiction_is_one_line():
    one = Topic("t", 12, 3, {"retention.ms": "100", "cleanup.policy": "delete"})
    assert contradictions(one, one) == []
    other = Topic("t", 6, 1, {"retention.ms": "100", "cleanup.policy": "compact"})
    said = contradictions(one, other)
    assert [line.split(":")[1].split(",")[0].strip() for line in said] == [
        "6 partitions",
        "on 1 brokers",
        "cleanup.policy = compact",
    ]


def test_a_broker_that_is_away_is_one_line(tmp_path, capsys):
    file = tmp_path / "fleet.toml"
    file.write_text("[broker]\naddresses = ['127.0.0.1:1']\ntimeout_s = 0.5\n", encoding="utf-8")
    assert run(["fleet", "topics", "--config", str(file)]) == 1
    said = capsys.readouterr().err.splitlines()
    away = "cannot be reached: is it running, and broker.addresses right?"
    assert said == [f"valvemap: broker 127.0.0.1:1: {away}"]


def test_without_the_extra_one_line_says_so(monkeypatch, capsys):
    monkeypatch.setattr("valvemap.cli.fleet.find_spec", lambda name: None)
    assert run(["fleet", "topics"]) == 2
    said = capsys.readouterr().err
    assert said == "valvemap: a fleet needs confluent_kafka: pip install 'valvemap[fleet]'\n"
