"""The fleet against a real Apache Kafka."""

import pytest
from support.broker import artifacts, brokers

pytest.importorskip("confluent_kafka")

from confluent_kafka.admin import AdminClient, NewPartitions

from service.cli import run

pytestmark = [pytest.mark.broker, pytest.mark.timeout(600)]


@pytest.fixture(scope="module")
def broker(request, tmp_path_factory):
    jars = artifacts(request.config.cache.mkdir("kafka"))
    with brokers(jars, tmp_path_factory.mktemp("kafka")) as (node,):
        yield f"127.0.0.1:{node.port}"


def write(folder, broker, prefix, more=""):
    file = folder / "fleet.toml"
    file.write_text(
        f"[broker]\naddresses = ['{broker}']\n"
        f"[topics]\nprefix = '{prefix}'\npartitions = 3\nreplication = 1\n{more}",
        encoding="utf-8",
    )
    return file


def test_topics_are_made_once_and_every_contradiction_is_named(broker, tmp_path, capsys):
    file = str(write(tmp_path, broker, "made"))
    assert run(["fleet", "topics", "-c", file]) == 0
    made = capsys.readouterr().out.splitlines()
    assert made[0] == "made.samples: made, 3 partitions on 1 brokers"
    assert len(made) == 4
    assert run(["fleet", "topics", "-c", file]) == 0
    assert set(capsys.readouterr().out.splitlines()) == {
        f"made.{kind}: as configured" for kind in ("samples", "commands", "results", "state")
    }
    admin = AdminClient({"bootstrap.servers": broker})
    for done in admin.create_partitions([NewPartitions("made.commands", 4)]).values():
        done.result()
    file = str(write(tmp_path, broker, "made", more="samples_h = 1\n"))
    assert run(["fleet", "topics", "-c", file]) == 1
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 3
    assert "made.samples: retention.ms = 172800000, 3600000 wanted" in said[0]
    assert said[1].startswith("made.commands: 4 partitions, 3 wanted")
    assert "made.commands: retention.ms" in said[2]
