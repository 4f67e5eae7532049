"""The whole service as a process of its own beside a numbered source, and what it has kept."""

import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from guarded_opcua import UserStore
from support.processes import free_port, service_url
from support.stream import SIGNALS
from valvemap.app.build import build_identification
from valvemap.config.loading import load_config
from valvemap.pipeline.provenance import ALARMS, MEMORY
from valvemap.runtime.kept_position import POSITION
from valvemap.storage.checkpoints import LOG, CheckpointFile

GATES = "{ U = { max_rate_per_s = 400.0 }, T = { frozen_s = 1e6 }, Q = { spike = 60.0 } }"
ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Account:
    """What of a numbered valve's samples a service has learnt, by what it has kept.

    ``different`` names what differs from one life over the same samples; the alarms, of which some
    are judged at the ends of batches, are not looked at.
    """

    learnt: int
    lost: int
    twice: int
    different: tuple[str, ...]

    def row(self, lives=""):
        """Cells of a table: lost, twice, different, and one that is empty."""
        return f"{self.lost} of {self.learnt}{lives} | {self.twice} | {len(self.different)} |"


class Whole:
    """Writes a service's configuration in a folder and starts it, as often as wanted.

    ``kinds`` are the estimators of some valves; the others have those of the default.
    """

    def __init__(self, folder, served, valves=("V1",), *, source="", kinds=None, command=None):
        self.plant, password = served
        self.file, self.state = folder / "service.toml", folder / "state.sqlite"
        self.log = folder / "service.log"
        self.url = service_url(free_port())
        self.valves = valves
        self.command = command or [sys.executable, "-u", "-m", "valvemap", "serve", "--config"]
        self._head = f"""
            [source]
            url = "opc.tcp://127.0.0.1:{self.plant.port}/plant/"
            security = "None"
            user = "operator"
            password = "{password}"
            startup_timeout_s = 120.0
            {source}
            [server]
            url = "{self.url}"
            [security]
            pki = "{folder}/pki"
            users = "{folder}/users.json"
            [state]
            file = "{self.state}"
        """
        UserStore().save(folder / "users.json")
        self.write(kinds or {})

    def write(self, kinds):
        """Write the configuration anew."""
        text = self._head
        for name in self.valves:
            nodes = ", ".join(
                f'{"sequence" if s == "Sequence" else s} = "nsu=urn:plant;s={name}.{s}"'
                for s in SIGNALS
            )
            text += f'\n[[valves]]\nname = "{name}"\nnodes = {{ {nodes} }}\ngate = {GATES}\n'
            if name in kinds:
                text += f"estimators = {kinds[name]}\n"
        self.file.write_text(text, encoding="utf-8")

    @contextmanager
    def life(self, env=None):
        """One life; it is killed at the end, if it still lives."""
        with self.log.open("ab") as log:
            process = subprocess.Popen(
                [*self.command, str(self.file)], stdout=log, stderr=log, cwd=ROOT, env=env
            )
            try:
                yield process
            finally:
                if process.poll() is None:
                    process.kill()
                process.wait()

    def check(self, process):
        """It must not have ended by itself."""
        assert process.poll() is None, self.log.read_text()[-2000:]

    def end(self, process, patience_s=30.0):
        """Have it end as people do."""
        process.send_signal(signal.SIGTERM)
        assert process.wait(patience_s) == 0, self.log.read_text()[-2000:]

    def hang_up(self, process):
        """Have it read its configuration again."""
        process.send_signal(signal.SIGHUP)

    @property
    def refusals(self):
        """How often it said that it could not take up what was kept."""
        return sum(map(self.said, ("checkpoints damaged", "set aside")))

    def said(self, text):
        """How often the log says so."""
        return self.log.read_text(errors="replace").count(text) if self.log.exists() else 0

    def kept(self):
        """What a service that is gone has kept, by (valve, estimator); is some of it damaged."""
        with tempfile.TemporaryDirectory() as name:
            for part in self.state.parent.glob(f"{self.state.name}*"):
                if not part.name.endswith("-shm"):
                    shutil.copy(part, name)
            with CheckpointFile(Path(name) / self.state.name) as store:
                found = {(c.valve, c.estimator): c for c in store.load()}
                damaged = store.set_aside is not None or set(store.damaged) - {LOG}
        return found, bool(damaged)

    def has_kept(self):
        """Whether a place at the source has been kept, by a service that may be at it."""
        query = "SELECT count(*) FROM checkpoint WHERE valve = ? AND estimator = ?"
        with (
            suppress(sqlite3.OperationalError),  # not made yet
            closing(sqlite3.connect(f"file:{self.state}?mode=ro", uri=True)) as file,
        ):
            return file.execute(query, POSITION).fetchone()[0] > 0
        return False

    def account(self, valve="V1"):
        """What was learnt of a valve, against one life over the samples that were sent."""
        config = load_config(self.file)
        number = [one.name for one in config.valves].index(valve)
        alone = config.model_copy(update={"valves": (config.valves[number],)})
        own = [c for (of, _), c in self.kept()[0].items() if of == valve]
        again, once = build_identification(alone), build_identification(alone)
        _, refused = again.restore(own)
        assert not refused, refused
        counters = again.results.counters(0)
        lost = counters["gaps"] + counters["missing"] + counters["lost_by_time"]
        (t,) = (c.t for c in own if c.estimator == MEMORY)
        by_time = {when // 100 * 100: k for k, (when, _) in self.plant.sent.items()}
        stop = by_time[t] + 1
        first = stop - counters["aligned"] - lost
        once.take(self.plant.sent_between(first, stop, number))
        right = {c.estimator: c.state for c in once.states.kept() if c.estimator != ALARMS}
        ours = {c.estimator: c.state for c in own if c.estimator != ALARMS}
        different = [name for name in {**right, **ours} if right.get(name) != ours.get(name)]
        twice = counters["duplicates"] + counters["late"]
        return Account(counters["aligned"], lost, twice, tuple(sorted(different)))
