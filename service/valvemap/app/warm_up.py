"""Compiles every kernel in advance, so that no sample waits for the compiler."""

import atexit
import gc
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from multiprocessing.sharedctypes import Synchronized
from typing import Final

from valvemap.app.warm_up_parts import compile_here, parts_of
from valvemap.config.meters import meters_of
from valvemap.config.models import Config
from valvemap.config.valves import ValveConfig
from valvemap.model.kernels.compiled import take_shortcuts
from valvemap.model.kernels.warmed_up import note_warm_up, was_warmed_up
from valvemap.numba_version import are_shortcuts_asked_for

Progress = Callable[[int, int], None]  # parts done, parts in total
_REPORT_EVERY_S = 5.0
_POLL_S: Final = 0.5  # s; longest delay until a request to end is noticed
_MOST_HELPERS: Final = 2  # processes; a third finds little work, and each needs 150 MB
_NICENESS: Final = 5  # the running service has priority
_OF_ONE = {"name", "nodes", "source", "identification"}  # fields without effect on the kernels


def warm_up(
    config: Config,
    progress: Progress = lambda _done, _of: None,
    is_over: Callable[[], bool] = lambda: False,
) -> None:
    """Compile every kernel that this configuration needs.

    The first run on a machine compiles for some two minutes and caches the result on disk; later
    runs load it. Two processes share the parts, each taking the next free one. ``progress`` is
    called periodically with the number of parts done. No further part is started once
    ``is_over`` returns True.
    """
    config = _one_of_each_kind(config)
    if not was_warmed_up():
        _compile_in_parts(config, progress, is_over)
    if is_over():
        return
    compile_here(config)
    note_warm_up()


def warm_up_aside(
    config: Config,
    progress: Progress = lambda _done, _of: None,
    is_over: Callable[[], bool] = lambda: False,
) -> None:
    """Compile every kernel in other processes of low priority, without use of this one's kernels.

    They share the parts as in `warm_up`, and are terminated as soon as ``is_over`` returns True.
    """
    config = _one_of_each_kind(config)
    if was_warmed_up():
        return
    of = len(parts_of(config))
    with _helpers(config, min(os.cpu_count() or 1, _MOST_HELPERS), _NICENESS) as shared:
        while any(helper.is_alive() for helper in shared.helpers) and not is_over():
            progress(shared.done.value, of)
            wait([helper.sentinel for helper in shared.helpers if helper.is_alive()], _POLL_S)
        if is_over():
            for helper in shared.helpers:
                helper.terminate()
    if shared.done.value == of:
        note_warm_up()


def _one_of_each_kind(config: Config) -> Config:
    """Return the configuration with one valve of each kind, apart from names and nodes.

    Two are kept of those behind one meter, which share more than the kind.
    """
    kinds: dict[tuple[str, str], ValveConfig] = {}
    behind = meters_of(config.valves)
    two = [name for name, meter in behind.items() if meter == next(iter(behind.values()))][:2]
    for valve in config.valves:
        kind = valve.model_dump_json(exclude=_OF_ONE)
        kinds.setdefault((kind, valve.name if valve.name in two else ""), valve)
    return config.model_copy(update={"valves": tuple(kinds.values())})


def _compile_in_parts(config: Config, progress: Progress, is_over: Callable[[], bool]) -> None:
    """Compile the slow parts, each in one of two processes."""
    finished, of = threading.Event(), len(parts_of(config))
    with _helpers(config, min((os.cpu_count() or 1) - 1, 1), 0) as shared:

        def report() -> None:
            while not finished.wait(_REPORT_EVERY_S):
                progress(shared.done.value, of)

        threading.Thread(target=report, daemon=True).start()
        try:
            _take_parts(config, shared.taken, shared.done, is_over)
        finally:
            finished.set()


@dataclass(frozen=True)
class _Shared:
    """Numbers of parts taken and done, shared with the helping processes."""

    taken: "Synchronized[int]"
    done: "Synchronized[int]"
    helpers: tuple[SpawnProcess, ...]


# A process that ends while it starts another would leave that one without its arguments.
_starting = threading.Lock()
atexit.register(_starting.acquire)


@contextmanager
def _helpers(config: Config, number: int, niceness: int) -> Iterator[_Shared]:
    """Run processes that take parts; wait for their ends."""
    context = get_context("spawn")
    taken, done = context.Value("i", 0), context.Value("i", 0)
    given = config, taken, done, gc.get_threshold(), are_shortcuts_asked_for(), niceness
    helpers = [context.Process(target=_help, args=given, daemon=True) for _ in range(number)]
    with _starting, _without_ctrl_c():
        for helper in helpers:
            helper.start()
    yield _Shared(taken, done, tuple(helpers))
    for helper in helpers:
        helper.join()


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """Block SIGINT in this thread: a process that it starts inherits that, before its first line.

    `_help` would ignore Ctrl-C only once everything is imported.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _help(
    config: Config,
    taken: "Synchronized[int]",
    done: "Synchronized[int]",
    collecting: tuple[int, int, int],
    shortcuts: bool,  # noqa: FBT001 - arguments of a process are positional
    niceness: int,
) -> None:
    """Compile parts in another process, with the parent's GC thresholds; ignore Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(niceness)
    gc.set_threshold(*collecting)
    if shortcuts:
        take_shortcuts()
    _take_parts(config, taken, done, lambda: False)
    os._exit(0)  # skips the interpreter's shutdown: the parent waits, and it takes 0.5 s


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None  # noqa: S101 - this runs in a child process
    wait([parent.sentinel])
    os._exit(1)


def _take_parts(
    config: Config,
    taken: "Synchronized[int]",
    done: "Synchronized[int]",
    is_over: Callable[[], bool],
) -> None:
    parts = parts_of(config)
    while True:
        with taken.get_lock():
            if is_over():
                taken.value = len(parts)  # stops the other process, too
            mine, taken.value = taken.value, taken.value + 1
        if mine >= len(parts):
            return
        parts[mine]()
        with done.get_lock():
            done.value += 1
