"""Processor time of each test and fixture, its child processes included.

    PYTHONPATH=tests python -m pytest -p support.cpu_times --cpu-times=FOLDER FILES
    python tests/support/cpu_times.py FOLDER

The first writes a file per process of pytest, the second ranks what cost most. Unlike wall time,
these seconds hardly depend on what else runs on the machine. A child counts when it is reaped.
"""

import resource
import sys
from collections import Counter
from collections.abc import Iterator
from os import getpid
from pathlib import Path
from typing import TextIO

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--cpu-times", type=Path, help="folder for one file per process")


def pytest_configure(config: pytest.Config) -> None:
    folder = config.getoption("--cpu-times")
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        rows = (folder / f"{getpid()}.tsv").open("w", encoding="utf-8", buffering=1)
        config.pluginmanager.register(CpuTimes(rows), "cpu-times")


class CpuTimes:
    """Writes `kind, seconds, test or fixture` rows, a fixture's without what it asked for."""

    def __init__(self, rows: TextIO) -> None:
        self.rows = rows
        self.inner = [0.0]

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        yield from self.timed("setup", item.nodeid)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        yield from self.timed("call", item.nodeid)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Iterator[None]:
        yield from self.timed("teardown", item.nodeid)

    @pytest.hookimpl(wrapper=True)
    def pytest_collection(self) -> Iterator[None]:
        yield from self.timed("collect", "collection")

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[object]) -> Iterator[None]:
        self.inner.append(0.0)
        began = used()
        try:
            return (yield)
        finally:
            spent = used() - began
            own = spent - self.inner.pop()
            self.inner[-1] += spent
            self.rows.write(f"fixture\t{own:.4f}\t{fixturedef.baseid}::{fixturedef.argname}\n")

    def timed(self, kind: str, name: str) -> Iterator[None]:
        began = used()
        try:
            return (yield)
        finally:
            self.rows.write(f"{kind}\t{used() - began:.4f}\t{name}\n")


def used() -> float:
    """Processor seconds of this process, of its reaped children and of commands in forks."""
    from support.command_forks import Fork  # here: ranking needs none of it

    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return Fork.spent_s + sum(usage.ru_utime + usage.ru_stime for usage in usages)


def ranked(folder: Path, shown: int = 40) -> str:
    """The dearest files, tests and fixtures of all processes."""
    files: Counter[str] = Counter()
    tests: Counter[str] = Counter()
    fixtures: Counter[str] = Counter()
    for path in folder.glob("*.tsv"):
        for line in path.read_text(encoding="utf-8").splitlines():
            kind, seconds, name = line.split("\t", 2)
            if kind == "fixture":
                fixtures[name] += float(seconds)
            else:
                files[name.split("::")[0]] += float(seconds)
                tests[name] += float(seconds)
    parts = [f"{sum(files.values()):9.1f} s in all, {len(tests)} tests"]
    for title, counted in (("files", files), ("tests", tests), ("fixtures", fixtures)):
        parts += ["", title]
        parts += [f"{seconds:9.2f} s  {name}" for name, seconds in counted.most_common(shown)]
    return "\n".join(parts)


if __name__ == "__main__":
    sys.stdout.write(ranked(Path(sys.argv[1])) + "\n")
