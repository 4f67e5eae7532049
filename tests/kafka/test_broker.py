"""The fleet against a real Apache Kafka."""

import pytest

from support.broker import artifacts, brokers
from support.processes import wait_for

pytest.importorskip("confluent_kafka")

from confluent_kafka.admin import AdminClient, NewPartitions

from support.fleet_trial import BLOCKS, GROUPS, Trial, write
from valvemap.cli import run

pytestmark = [pytest.mark.broker, pytest.mark.timeout(600)]


def test_topics_are_made_once_and_every_contradiction_is_named(broker, tmp_path, capsys):
    file = str(write(tmp_path, broker, "made"))
    assert run(["fleet", "topics", "-c", file]) == 0
    made = capsys.readouterr().out.splitlines()
    assert made[0] == "made.samples: made, 3 partitions on 1 brokers"
    assert len(made) == 5
    assert run(["fleet", "topics", "-c", file]) == 0
    assert set(capsys.readouterr().out.splitlines()) == {
        f"made.{kind}: as configured"
        for kind in ("samples", "commands", "results", "rejected", "state")
    }
    admin = AdminClient({"bootstrap.servers": broker})
    for done in admin.create_partitions([NewPartitions("made.commands", 4)]).values():
        done.result()
    file = str(write(tmp_path, broker, "made", more="samples_h = 1\n"))
    assert run(["fleet", "topics", "-c", file]) == 1
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 4
    assert "made.samples: retention.ms = 172800000, 3600000 wanted" in said[0]
    assert said[1].startswith("made.commands: 4 partitions, 3 wanted")
    assert "made.commands: retention.ms" in said[2]


def test_workers_that_are_killed_and_join_come_to_one_machines_bits(broker, tmp_path, capsys):
    trial = Trial(tmp_path, broker, "killed")
    with trial.worker(1) as first, trial.worker(2):
        trial.send(0, 20)
        trial.until_each_is_behind(5)
        trial.send(20, 40)
        first.kill()
        with trial.worker(3) as third:
            trial.send(40, BLOCKS + 4)
            trial.until_each_is_behind(BLOCKS)
            capsys.readouterr()
            assert run(["fleet", "status", "-c", str(trial.file)]) == 0
            head, *rows = (line.split() for line in capsys.readouterr().out.splitlines())
        assert head == ["group", "partition", "lag", "block", "age", "s", "kB", "owner"]
        assert [(row[0], row[2], row[3]) for row in rows] == [(g, "0", f"{BLOCKS}") for g in GROUPS]
        assert all(row[-1].endswith("@127.0.0.1") for row in rows)
        assert third.returncode == 0, trial.log(3).read_text()
    trial.check_bits()


def test_a_broker_that_is_killed_and_comes_back_loses_nothing(request, tmp_path):
    jars = artifacts(request.config.cache.mkdir("kafka"))
    with brokers(jars, tmp_path / "kafka") as (node,):
        trial = Trial(tmp_path, f"127.0.0.1:{node.port}", "away")
        with trial.worker(1) as worker:
            trial.send(0, 30)
            trial.until_each_is_behind(5)
            node.kill()
            wait_for(trial.log(1), "broker cannot be reached", worker)
            node.start()
            node.wait()
            trial.send(30, BLOCKS + 4)
            trial.until_each_is_behind(BLOCKS)
            assert worker.poll() is None
        assert worker.returncode == 0, trial.log(1).read_text()
        trial.check_bits()
        said = [line for line in trial.log(1).read_text().splitlines() if "info " not in line]
        assert len(said) <= 4, said  # that it is away, and what was lost by it


def test_a_commit_may_take_longer_than_a_worker_may_be_silent(broker, tmp_path):
    trial = Trial(tmp_path, broker, "rare", work="commit_s = 6\ntakeover_s = 2")
    with trial.worker(1) as worker:
        trial.send(0, 30)
        trial.until_each_is_behind(5)
        trial.send(30, BLOCKS + 4)
        trial.until_each_is_behind(BLOCKS)
        assert worker.poll() is None
    assert worker.returncode == 0, trial.log(1).read_text()
    trial.check_bits()
    assert all("info " in line for line in trial.log(1).read_text().splitlines())


@pytest.mark.soak
def test_one_of_three_brokers_that_is_killed_is_not_missed(request, tmp_path):
    jars = artifacts(request.config.cache.mkdir("kafka"))
    with brokers(jars, tmp_path / "kafka", 3) as nodes:
        addresses = ",".join(f"127.0.0.1:{node.port}" for node in nodes)
        trial = Trial(tmp_path, addresses, "three", 3)
        with trial.worker(1) as worker:
            trial.send(0, 30)
            trial.until_each_is_behind(5)
            nodes[0].kill()
            trial.send(30, BLOCKS + 4)
            trial.until_each_is_behind(BLOCKS)
        assert worker.returncode == 0, trial.log(1).read_text()
        trial.check_bits()


def test_topics_of_other_partitions_stop_a_worker_with_one_line(broker, tmp_path):
    trial = Trial(tmp_path, broker, "changed")
    admin = AdminClient({"bootstrap.servers": broker})
    for done in admin.create_partitions([NewPartitions("changed.samples", 4)]).values():
        done.result()
    with trial.worker(1) as worker:
        assert worker.wait(60) == 1
    said = trial.log(1).read_text().splitlines()
    assert len(said) == 1
    assert said[0].startswith("valvemap: changed.samples: 4 partitions, 3 wanted")
