"""A real Apache Kafka (KRaft) out of Maven artifacts: loopback only, gone at the end."""

import os
import shutil
import signal
import subprocess
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from support.building import building
from support.processes import free_port, is_open

POM = Path(__file__).parents[1] / "kafka" / "broker" / "pom.xml"
CLUSTER = "MkU3OEVBNTcwNTJENDM2Qg"
HEAP = "-Xmx384m"
_LOG = """\
rootLogger.level = WARN
rootLogger.appenderRef.c.ref = C
appender.c.type = Console
appender.c.name = C
appender.c.layout.type = PatternLayout
appender.c.layout.pattern = %d{HH:mm:ss} %p %c{1} %m%n
"""


def artifacts(cache: Path) -> Path:
    """Return the folder of Kafka's jars; skip the test where they cannot be had."""
    maven, java = shutil.which("mvn"), shutil.which("java")
    if maven is None or java is None:
        pytest.skip("mvn and java are not installed")
    jars = cache / "libs"
    with building(cache):
        if not (cache / "ready").exists():
            command = [maven, "-q", "-B", "-f", POM, "dependency:copy-dependencies"]
            try:
                done = subprocess.run(
                    [*command, f"-DoutputDirectory={jars}"],
                    capture_output=True,
                    text=True,
                    timeout=280,
                    check=False,
                )
            except subprocess.TimeoutExpired:
                pytest.skip("mvn took longer than 280 s")
            if done.returncode:
                pytest.skip(f"mvn failed: {done.stdout.strip()[-300:]}")
            (cache / "ready").touch()
    return jars


class Node:
    """One broker that is its own controller among N."""

    def __init__(self, jars, folder, number, ports, controllers, more=None, options=()):
        self.port = ports[number - 1]
        self._folder = folder / f"node{number}"
        self._folder.mkdir(parents=True)
        (self._folder / "log4j2.properties").write_text(_LOG)
        three = len(ports) > 2
        voters = (f"{k}@127.0.0.1:{port}" for k, port in enumerate(controllers, 1))
        settings = {
            "process.roles": "broker,controller",
            "node.id": number,
            "controller.quorum.voters": ",".join(voters),
            "listeners": f"PLAINTEXT://127.0.0.1:{self.port},"
            f"CONTROLLER://127.0.0.1:{controllers[number - 1]}",
            "advertised.listeners": f"PLAINTEXT://127.0.0.1:{self.port}",
            "controller.listener.names": "CONTROLLER",
            "inter.broker.listener.name": "PLAINTEXT",
            "listener.security.protocol.map": "PLAINTEXT:PLAINTEXT,CONTROLLER:PLAINTEXT",
            "log.dirs": self._folder / "data",
            "offsets.topic.replication.factor": 3 if three else 1,
            "transaction.state.log.replication.factor": 3 if three else 1,
            "transaction.state.log.min.isr": 2 if three else 1,
            "min.insync.replicas": 2 if three else 1,
            "offsets.topic.num.partitions": 4,
            "transaction.state.log.num.partitions": 4,
            "transaction.abort.timed.out.transaction.cleanup.interval.ms": 1000,
            "group.initial.rebalance.delay.ms": 0,
            "group.min.session.timeout.ms": 1000,
            "message.max.bytes": 16_000_000,
            "replica.fetch.max.bytes": 16_000_000,
            "auto.create.topics.enable": "false",
            **(more or {}),
        }
        self._settings = self._folder / "server.properties"
        self._settings.write_text("".join(f"{k}={v}\n" for k, v in settings.items()))
        self._java = ["java", "-cp", f"{jars}/*"]
        self._java += [f"-Dlog4j2.configurationFile={self._folder / 'log4j2.properties'}"]
        self._java += options
        command = ["kafka.tools.StorageTool", "format", "-t", CLUSTER, "-c", self._settings]
        subprocess.run([*self._java, *command], check=True, capture_output=True)
        self._process = None

    def start(self):
        """Start it; it does not listen at once."""
        command = ["nice", "-n", "12", self._java[0], HEAP, *self._java[1:]]
        with (self._folder / "log").open("ab") as log:
            self._process = subprocess.Popen(
                [*command, "kafka.Kafka", self._settings], stdout=log, stderr=log
            )

    def wait(self, seconds=90.0):
        """Wait until it listens."""
        end = time.monotonic() + seconds
        while not is_open(self.port):
            assert self._process.poll() is None, (self._folder / "log").read_text()[-2000:]
            assert time.monotonic() < end, "the broker does not listen"
            time.sleep(0.1)

    def kill(self):
        """End it as a power cut would."""
        if self._process is not None:
            os.kill(self._process.pid, signal.SIGKILL)
            self._process.wait()
            self._process = None


@contextmanager
def brokers(jars, folder, n=1):
    """N nodes of one cluster, listening."""
    ports = [free_port() for _ in range(n)]
    controllers = [free_port() for _ in range(n)]
    nodes = [Node(jars, folder, k, ports, controllers) for k in range(1, n + 1)]
    with ExitStack() as stack:
        for node in nodes:
            stack.callback(node.kill)
            node.start()
        for node in nodes:
            node.wait()
        yield nodes
