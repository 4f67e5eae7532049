"""``valvemap fleet reidentify``: months of recordings on many processes, valve by valve.

Valves are independent of each other, so each is learnt by itself, as `replay` learns it, to the
bit. What is done is noted beside the models: who is killed goes on with the rest.
"""

import gc
import hashlib
import json
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import dask
from dask.distributed import Client, LocalCluster, as_completed

from valvemap.config.models import Config
from valvemap.errors import FleetError, RecordingError, StorageError, ValvemapError

AT_ONCE: Final = 8  # valves of the same files in one task: a file is read once for all of them
NOTES: Final = "done"  # folder of what was done, a file for each valve
_JSON: Final = "models.json"

# Arrays of a chunk are freed and made anew: memory that goes back to the system each time costs as
# much as learning does, and Dask would have it so. Nor need anybody see what workers do, 100 times
# a second.
_OF_WORKERS: Final = {
    "distributed.nanny.pre-spawn-environ": {
        "MALLOC_TRIM_THRESHOLD_": 1 << 28,
        "MALLOC_MMAP_THRESHOLD_": 1 << 25,
    },
    "distributed.worker.profile.enabled": False,
}

Progress = Callable[[int, int], None]  # valves that are done, of how many


@dataclass(frozen=True)
class Task:
    """Some valves, and the files that they are in, in the order of their times."""

    valves: tuple[str, ...]
    files: tuple[Path, ...]
    config: Config | None
    target: Path
    insist: bool
    digests: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """How many valves came of it, how many were there already, and what went wrong."""

    valves: int
    known: int
    refused: tuple[str, ...]


def reidentify(
    files: Sequence[Path],
    target: Path,
    config: Config | None = None,
    *,
    processes: int = 1,
    scheduler: str | None = None,
    insist: bool = False,
    progress: Progress = lambda _done, _of: None,
) -> Outcome:
    """Learn all valves of some recordings anew, and save their maps in a folder.

    The folder gets ``<Valve>.<Estimator>.json``, as ``replay --save`` writes them, and
    ``models.json``, as ``replay --json``.

    Parameters
    ----------
    files
        Recordings, in the order of their time.
    target
        The folder.
    config
        As of `replay`.
    processes
        How many learn side by side, where there is no ``scheduler``.
    scheduler
        Address of a Dask cluster, whose workers see the same files under the same names.
    insist
        As of `replay`.
    progress
        Hears how many valves are done.

    Raises
    ------
    RecordingError, StorageError, ConfigurationError
        if nothing can be begun; what is wrong with single valves is in the outcome.
    FleetError
        if the cluster cannot be reached, or goes away.
    """
    _make(target / NOTES)
    with _cluster(processes, scheduler) as client:
        each = client.map(_valves_in, files, config=config, pure=False)
        where = _where(files, [_result(one) for one in each])
        tasks, known, digests = _tasks(where, target, config, insist=insist)
        done, refused = known, list[str]()
        progress(done, len(digests))
        of_future = {client.submit(learn, task, pure=False): task for task in tasks}
        for future in as_completed(list(of_future)):  # type: ignore[no-untyped-call]
            refused += _result(future)
            done += len(of_future.pop(future).valves)
            progress(done, len(digests))
    _write_all(target, digests)
    return Outcome(len(digests) - len(refused), known, tuple(refused))


def learn(task: Task) -> list[str]:
    """Learn some valves, save what came of each, and note that; return what went wrong."""
    # The workers alone import what learns: who hands out tasks would be a second late with them.
    from valvemap.app.models import save_models  # noqa: PLC0415
    from valvemap.app.replay import as_json, replay  # noqa: PLC0415

    only = frozenset(task.valves)
    try:
        report = replay(task.files, task.config, insist=task.insist, only=only, read_ahead=False)
    except RecordingError as error:
        if len(task.valves) == 1:
            return [str(error)]
        return [line for one in _one_by_one(task) for line in learn(one)]
    except ValvemapError as error:
        return [str(error)]
    figures = as_json(report)
    for valve, digest in zip(task.valves, task.digests, strict=True):
        try:
            save_models(task.target, {valve: report[valve]})
            _write(_note(task.target, valve), {"of": digest, "figures": figures[valve]})
        except StorageError as error:
            return [str(error)]
    return []


def _one_by_one(task: Task) -> Iterator[Task]:
    for valve, digest in zip(task.valves, task.digests, strict=True):
        yield Task((valve,), task.files, task.config, task.target, task.insist, (digest,))


def _tasks(
    where: Mapping[str, tuple[Path, ...]], target: Path, config: Config | None, *, insist: bool
) -> tuple[list[Task], int, dict[str, str]]:
    """What is to be done, how many valves are done, and what each is to be learnt from."""
    by_files: dict[tuple[Path, ...], list[str]] = {}
    for valve, own in where.items():
        by_files.setdefault(own, []).append(valve)
    tasks, known, digests = [], 0, {}
    for own, valves in by_files.items():
        stamp = _stamp(own, insist=insist)
        for valve in valves:
            digests[valve] = _digest(stamp, valve, config)
        left = [valve for valve in valves if not _is_done(target, valve, digests[valve])]
        known += len(valves) - len(left)
        for first in range(0, len(left), AT_ONCE):
            some = tuple(left[first : first + AT_ONCE])
            of = tuple(digests[name] for name in some)
            tasks.append(Task(some, own, config, target, insist, of))
    return tasks, known, digests


def _valves_in(file: Path, config: Config | None) -> list[str] | str:
    """The valves in a file that are wanted; or why it cannot be read."""
    from valvemap.app.build import build_layout  # noqa: PLC0415 - as in `learn`
    from valvemap.storage.recordings import read_recording  # noqa: PLC0415

    layout = None if config is None else build_layout(config)
    wanted = None if config is None else {valve.name for valve in config.valves}
    try:
        with read_recording(file, layout=layout) as recording:
            names = dict.fromkeys(name for name, _ in recording)
    except ValvemapError as error:
        return str(error)
    return [name for name in names if wanted is None or name in wanted]


def _where(files: Sequence[Path], valves: Sequence[list[str] | str]) -> dict[str, tuple[Path, ...]]:
    """The files that each valve is in."""
    found: dict[str, list[Path]] = {}
    for file, names in zip(files, valves, strict=True):
        if isinstance(names, str):
            raise RecordingError(names)
        for name in names:
            found.setdefault(name, []).append(file)
    if not found:
        raise RecordingError(f"{files[0]}: no valve of the configuration is in the recordings")
    return {name: tuple(own) for name, own in found.items()}


def _stamp(files: Sequence[Path], *, insist: bool) -> str:
    """What would change what is learnt: the files, and who learns."""
    said = [(file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    return json.dumps([version("valvemap"), insist, said])


def _digest(stamp: str, valve: str, config: Config | None) -> str:
    own = ""
    if config is not None:
        (one,) = (each for each in config.valves if each.name == valve)
        own = one.model_dump_json() + config.recording.model_dump_json()
    return hashlib.sha256(f"{stamp}{valve}{own}".encode()).hexdigest()


def _note(target: Path, valve: str) -> Path:
    return target / NOTES / f"{valve}.json"


def _is_done(target: Path, valve: str, digest: str) -> bool:
    return bool(_read_note(target, valve).get("of") == digest)


def _read_note(target: Path, valve: str) -> Mapping[str, Any]:
    try:
        found = json.loads(_note(target, valve).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _write_all(target: Path, digests: Mapping[str, str]) -> None:
    """The figures of all valves that are done, in one file."""
    notes = {valve: _read_note(target, valve) for valve in digests}
    figures = {
        valve: note["figures"] for valve, note in notes.items() if note.get("of") == digests[valve]
    }
    _write(target / _JSON, figures)


def _write(file: Path, content: object) -> None:
    """Whole or not at all."""
    part = file.with_name(f"{file.name}.part")
    try:
        text = json.dumps(content, indent=2, allow_nan=False) + "\n"
        part.write_text(text, encoding="utf-8")
        part.replace(file)
    except OSError as error:
        raise StorageError(f"{file}: {(error.strerror or str(error)).lower()}") from None


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{folder}: {(error.strerror or str(error)).lower()}") from None


def _result(future: Any) -> Any:  # noqa: ANN401 - Dask's
    try:
        return future.result()
    except Exception as error:  # noqa: BLE001 - a worker that died, or a fault of ours
        raise FleetError(f"a worker failed: {(str(error).splitlines() or [''])[0]}") from None


@contextmanager
def _cluster(processes: int, scheduler: str | None) -> Iterator[Client]:
    logging.getLogger("distributed").setLevel(logging.ERROR)
    try:
        if scheduler is not None:
            with Client(scheduler, timeout=10) as client:  # type: ignore[no-untyped-call]
                yield client
            return
        with (
            dask.config.set(_OF_WORKERS),
            LocalCluster(  # type: ignore[no-untyped-call]
                n_workers=processes,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
                host="127.0.0.1",
                memory_limit=0,
                silence_logs=logging.ERROR,
            ) as cluster,
            Client(cluster) as client,  # type: ignore[no-untyped-call]
        ):
            client.run(gc.set_threshold, 50_000, 20, 20)  # what is imported is no garbage
            yield client
            client.run(gc.freeze)  # nor need it be looked through at the end
    except OSError as error:
        where = scheduler or "127.0.0.1"
        raise FleetError(f"{where}: no Dask cluster: {_first_line(error)}") from None


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
