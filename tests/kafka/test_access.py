"""The broker of the compose profile: TLS, passwords, and no user may do more than it must."""

import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest
import yaml

from support.broker import Node, artifacts
from support.processes import free_port, running, wait_for

pytest.importorskip("confluent_kafka")

from confluent_kafka import Consumer, KafkaError, KafkaException, Producer, TopicPartition
from confluent_kafka.admin import AdminClient, NewTopic

from support import fleet_server
from support.fleet import as_messages, day
from support.kafka import until
from support.processes import program
from valvemap.cli import run
from valvemap.kafka.broker import client_settings
from valvemap.kafka.catalogue import load_catalogue
from valvemap.kafka.settings import load_fleet
from valvemap.kafka.status import status

ROOT = Path(__file__).parents[2]
pytestmark = [pytest.mark.broker, pytest.mark.timeout(600)]
PASSWORD = "a long enough password"


def script(name):
    """A script of the compose profile."""
    spec = spec_from_file_location(name, ROOT / "container" / "fleet" / f"{name}.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def secrets(tmp_path_factory):
    """What `fleet-secrets` makes: the broker's folder, and ours."""
    kafka, ours = tmp_path_factory.mktemp("kafka"), tmp_path_factory.mktemp("ours") / "kafka"
    script("secrets_of_kafka").main(kafka, ours, ["127.0.0.1", "kafka"])
    return kafka, ours


def test_secrets_are_made_once_and_passwords_are_readable_by_their_owner_alone(secrets):
    kafka, ours = secrets
    made = {file: file.read_text() for folder in secrets for file in folder.iterdir()}
    script("secrets_of_kafka").main(kafka, ours, ["kafka"])
    assert {file: file.read_text() for folder in secrets for file in folder.iterdir()} == made
    passwords = sorted(ours.glob("*-password"))
    users = [one.name.partition("-")[0] for one in passwords]
    assert users == ["collect", "serve", "topics", "work"]
    assert {one.stat().st_mode & 0o777 for one in passwords} == {0o600}
    assert len({one.read_text() for one in passwords}) == 4


@pytest.fixture(scope="module")
def broker(request, secrets, tmp_path_factory):
    """Kafka with the settings of docker-compose.yml, at other ports and places."""
    kafka, _ = secrets
    jars = artifacts(request.config.cache.mkdir("kafka"))
    said = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]["kafka"]
    ports = dict(zip((9092, 9093, 9094), (free_port() for _ in range(3)), strict=True))
    settings = {}
    for name, value in said["environment"].items():
        if name in ("KAFKA_HEAP_OPTS", "KAFKA_OPTS"):
            continue
        own = value.replace("//:", "//127.0.0.1:").replace("kafka:", "127.0.0.1:")
        for old, new in ports.items():
            own = own.replace(f":{old}", f":{new}")
        key = name.removeprefix("KAFKA_").lower().replace("_", ".")
        settings[key] = own.replace("/etc/valvemap", str(kafka))
    settings.pop("log.dirs")
    login = f"-Djava.security.auth.login.config={kafka / 'jaas.conf'}"
    folder = tmp_path_factory.mktemp("node")
    node = Node(jars, folder, 1, [ports[9092]], [ports[9093]], settings, [login])
    try:
        node.start()
        node.wait()
        yield f"127.0.0.1:{ports[9092]}"
    finally:
        node.kill()


@pytest.fixture(scope="module")
def fleet(broker, secrets, tmp_path_factory):
    """A configuration for each user; the topics are there, and who may do what."""
    folder, (_, ours) = tmp_path_factory.mktemp("fleet"), secrets
    valves = "".join(
        f"[[valves]]\nname = 'V{k}'\n[[valves.estimators]]\nkind = 'RLS'\n" for k in range(2)
    )
    (folder / "north.toml").write_text(valves, encoding="utf-8")
    files = {}
    for user in ("topics", "collect", "work", "serve"):
        files[user] = folder / f"{user}.toml"
        files[user].write_text(
            f"[broker]\naddresses = ['{broker}']\ntls = true\nca_file = '{ours / 'ca.pem'}'\n"
            f"mechanism = 'PLAIN'\nuser = '{user}'\npassword_file = '{ours}/{user}-password'\n"
            "[topics]\npartitions = 3\nreplication = 1\n[work]\nresults_s = 0\n"
            "[catalogue]\nsites = { north = 'north.toml' }\n",
            encoding="utf-8",
        )
    assert run(["fleet", "topics", "-c", str(files["topics"])]) == 0
    script("access").main(files["topics"])
    return files


def clients(file):
    return client_settings(load_fleet(file).broker)


def test_a_fleet_works_with_what_each_user_may_do(fleet, tmp_path):
    config = load_fleet(fleet["work"])
    known = load_catalogue(config.catalogue)
    producer = Producer(
        {**clients(fleet["collect"]), "partitioner": "murmur2_random", "enable.idempotence": True}
    )
    env = {"VALVEMAP_FLEET_WORK__STATE": str(tmp_path / "state")}
    log, port = tmp_path / "server.log", free_port()
    command = "fleet", "work", "-c", str(fleet["work"])
    serve = sys.executable, "-u", Path(fleet_server.__file__), fleet["serve"], str(port), PASSWORD
    with (
        running(*command, env=env, log=tmp_path / "worker.log") as worker,
        program(*serve, log=log) as server,
    ):
        wait_for(log, "results served", server, 240.0)
        for kind, key, packed in as_messages(day(known.groups["north.0"])):
            if kind == "samples":
                producer.produce(f"valvemap.{kind}", packed, key)
        producer.produce("valvemap.samples", b"hostile", b"north.0")
        assert producer.flush(30.0) == 0
        until(lambda: (status(config)[0].memory or Nothing).number == 12, 120.0)
        until(lambda: status(config)[0].memory.counts["refused"] == 1, 30.0)
    assert worker.returncode == 0, (tmp_path / "worker.log").read_text()
    assert server.returncode == 0, log.read_text()


class Nothing:
    number = 0


@pytest.mark.parametrize(
    ("user", "kind"),
    [
        ("collect", "commands"),
        ("collect", "results"),
        ("collect", "rejected"),
        ("work", "samples"),
        ("work", "commands"),
        ("serve", "samples"),
        ("serve", "results"),
        ("serve", "state"),
    ],
)
def test_nobody_writes_what_is_for_others(fleet, user, kind):
    said = []
    producer = Producer(clients(fleet[user]) | {"message.timeout.ms": 5_000})
    producer.produce(f"valvemap.{kind}", b"x", on_delivery=lambda error, _: said.append(error))
    producer.flush(10.0)
    assert [error.code() for error in said] == [KafkaError.TOPIC_AUTHORIZATION_FAILED]


def test_a_collector_reads_nothing(fleet):
    consumer = Consumer(clients(fleet["collect"]) | {"group.id": "mine"})
    consumer.assign([TopicPartition("valvemap.results", 0, 0)])
    message = consumer.poll(10.0)
    consumer.close()
    assert message.error().code() in (
        KafkaError.TOPIC_AUTHORIZATION_FAILED,
        KafkaError.GROUP_AUTHORIZATION_FAILED,
    )


def test_a_wrong_password_and_no_password_open_nothing(fleet):
    right = clients(fleet["topics"])
    for wrong in (
        {"sasl.password": "another"},
        {"security.protocol": "ssl"},
        {"security.protocol": "plaintext"},
    ):
        admin = AdminClient({**right, **wrong, "log_level": 0})
        with pytest.raises(KafkaException):
            admin.list_topics(timeout=3.0)
    admin = AdminClient(clients(fleet["work"]))  # kept: without it there is no answer
    made = admin.create_topics([NewTopic("mine", 1, 1)])
    with pytest.raises(KafkaException):
        made["mine"].result(30.0)
