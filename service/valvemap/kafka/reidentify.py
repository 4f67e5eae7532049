"""``valvemap fleet reidentify``: months of recordings, distributed over processes by valve.

Valves are independent, so that the results equal those of `replay` bit by bit. Completed valves
are recorded beside the models; after an interruption, only the remaining ones are processed.
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
from valvemap.errors import FleetError, RecordingError, StorageError, ValvemapError, first_line
from valvemap.owned_files import make_folder, naming

AT_ONCE: Final = 8  # valves with the same files in one task: a file is read once for all of them
NOTES: Final = "done"  # folder of completion records, one file for each valve
_JSON: Final = "models.json"

# Dask sets MALLOC_TRIM_THRESHOLD_: returning the arrays of each chunk to the system and allocating
# them again takes as long as the estimation. Its profiler is not needed either, and would sample
# each worker 100 times a second.
_OF_WORKERS: Final = {
    "distributed.nanny.pre-spawn-environ": {
        "MALLOC_TRIM_THRESHOLD_": 1 << 28,
        "MALLOC_MMAP_THRESHOLD_": 1 << 25,
    },
    "distributed.worker.profile.enabled": False,
}

Progress = Callable[[int, int], None]  # completed valves, all valves


@dataclass(frozen=True)
class Task:
    """Valves, and the files that contain them, in order of time."""

    valves: tuple[str, ...]
    files: tuple[Path, ...]
    config: Config | None
    target: Path
    insist: bool
    digests: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """Number of valves completed, number completed before, and errors."""

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
    """Identify all valves of the given recordings, and save their maps in a folder.

    The folder gets ``<Valve>.<Estimator>.json``, as ``replay --save`` writes them, and
    ``models.json``, as ``replay --json``.

    Parameters
    ----------
    files
        Recordings, in order of time.
    target
        The folder.
    config
        As of `replay`.
    processes
        Number of worker processes, without a ``scheduler``.
    scheduler
        Address of a Dask cluster, whose workers have the same files at the same paths.
    insist
        As of `replay`.
    progress
        Called with the number of completed valves.

    Raises
    ------
    RecordingError, StorageError, ConfigurationError
        if the run cannot start; errors of single valves are in the outcome.
    FleetError
        if the cluster cannot be reached, or the connection is lost.
    """
    make_folder(target / NOTES)
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
    """Identify valves, save their maps, and record their completion; return errors."""
    # Imported by workers only: the import would delay the process that distributes tasks by 1 s.
    from valvemap.app.models import save_models  # noqa: PLC0415
    from valvemap.app.replay import replay  # noqa: PLC0415
    from valvemap.app.replay_report import as_json  # noqa: PLC0415

    only = frozenset(task.valves)
    try:
        report = replay(
            task.files,
            task.config,
            insist=task.insist,
            only=only,
            read_ahead=False,
            note=lambda _line: None,  # every worker would print the columns of the same files
        )
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
    """Return the remaining tasks, the number of completed valves, and the input digest of each."""
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
    """Return the configured valves in a file; or the reason why it cannot be read."""
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
    """Return the files that contain each valve."""
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
    """Fingerprint of everything that determines the result: files, version, options."""
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
    """Write the figures of all completed valves to one file."""
    notes = {valve: _read_note(target, valve) for valve in digests}
    figures = {
        valve: note["figures"] for valve, note in notes.items() if note.get("of") == digests[valve]
    }
    _write(target / _JSON, figures)


def _write(file: Path, content: object) -> None:
    """Write atomically."""
    part = file.with_name(f"{file.name}.part")
    with naming(file):
        text = json.dumps(content, indent=2, allow_nan=False) + "\n"
        part.write_text(text, encoding="utf-8")
        part.replace(file)


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
            client.run(gc.set_threshold, 50_000, 20, 20)  # imported modules are no garbage
            yield client
            client.run(gc.freeze)  # skip their collection at exit
    except OSError as error:
        where = scheduler or "127.0.0.1"
        raise FleetError(f"{where}: no Dask cluster: {first_line(error)}") from None
