"""Lists, adopts, renames, exports and imports the learnt states of a configuration's state file."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from valvemap.app.build import build_identification
from valvemap.config.models import Config
from valvemap.errors import StorageError
from valvemap.owned_files import written_aside
from valvemap.pipeline.provenance import BESIDE
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.storage.checkpoint_rows import SetAside
from valvemap.storage.checkpoints import CheckpointFile
from valvemap.storage.state_files import read_states, write_states
from valvemap.vocabulary.edges import split_id

_OF_SERVICE = "Service"  # its position and alarms are no states of a valve
_FITS = "fits the configuration"


def list_states(config: Config) -> Iterator[str]:
    """Yield a line per state: its newest sample, and what the next start makes of it.

    Raises
    ------
    StorageError
        if the file cannot be read.
    """
    stored, aside = read_states(config.state.file)
    identification = build_identification(config)
    reviewed = identification.states.review(stored)
    _, refused = identification.restore(reviewed.checkpoints)
    said = {**refused, **reviewed.changes, **reviewed.set_aside}
    for one in stored:
        if one.valve != _OF_SERVICE and one.estimator not in BESIDE:
            name = ".".join(
                reviewed.moved.get((one.valve, one.estimator), (one.valve, one.estimator))
            )
            yield f"{_name(one)}: {_until(one)}; {said.get(name, said.get(_name(one), _FITS))}"
    for number, one, reason in aside:
        yield f"{number} {_name(one)}: {_until(one)}; set aside: {reason}"


def adopt(config: Config, what: str) -> list[str]:
    """Restore states that are set aside, under the present configuration; return their names.

    ``what`` is a number that `list_states` shows, a valve, or ``<Valve>.<Estimator>``: the newest
    states of that name. The states in their place are set aside.

    Raises
    ------
    StorageError
        if there is no such state, one does not fit, or a service uses the file.
    """
    read_states(config.state.file)
    identification = build_identification(config)
    meanings = {plan.name: plan.meaning for plan in identification.plans}
    with CheckpointFile(config.state.file) as store:
        chosen = _chosen(store.aside(), what, config)
        own = []
        for _, one, _ in chosen:
            meaning = meanings.get(one.valve)
            if meaning is None:
                raise StorageError(f"{_name(one)}: no such valve is configured; rename it first")
            own.append(replace(one, meaning=meaning.to_text()))
        _, refused = identification.restore(own)
        for name, reason in refused.items():
            raise StorageError(f"{name}: {reason}")
        _replace(store, own, "replaced by an adopted state")
        store.forget_aside([number for number, _, _ in chosen])
    return [_name(one) for one in own]


def rename(config: Config, old: str, new: str) -> list[str]:
    """Give the states of a valve to another name; return their new names.

    Raises
    ------
    StorageError
        if there is no such state, or a service uses the file.
    """
    read_states(config.state.file)
    with CheckpointFile(config.state.file) as store:
        stored = store.load()
        own = [one for one in stored if one.valve == old != _OF_SERVICE]
        kept = [one for one in store.aside() if one.checkpoint.valve == old]
        if not own and not kept:
            raise _no_such(config, old, stored)
        there = [one for one in stored if one.valve == new]
        aside = [(one, f"replaced by the states of {old}") for one in there]
        aside += [(replace(one, valve=new), reason) for _, one, reason in kept]
        store.put_aside(aside, {(old, one.estimator): (new, one.estimator) for one in own})
        store.forget_aside([one.number for one in kept])
    return [f"{new}.{one.estimator}" for one in own if one.estimator not in BESIDE]


def export_states(config: Config, file: Path, valves: Sequence[str]) -> int:
    """Write the states of the given valves, or of all, to a new file; return their number.

    Raises
    ------
    StorageError
        if there is no such state, or a file cannot be read or written.
    """
    stored, _ = read_states(config.state.file)
    known = [one for one in stored if one.valve != _OF_SERVICE]
    for valve in valves:
        if all(one.valve != valve for one in known):
            raise _no_such(config, valve, known)
    own = [one for one in known if not valves or one.valve in valves]
    with written_aside(file) as draft:
        write_states(draft, own)
    return sum(one.estimator not in BESIDE for one in own)


def import_states(config: Config, file: Path, valves: Sequence[str]) -> list[str]:
    """Store the states of an exported file; return their names. Those in their place are set aside.

    The next start compares their nodes and units with the configuration.

    Raises
    ------
    StorageError
        if there is no such state, a file cannot be used, or a service uses the state file.
    """
    given, _ = read_states(file)
    known = [one for one in given if one.valve != _OF_SERVICE]
    for valve in valves:
        if all(one.valve != valve for one in known):
            raise StorageError(f"{file}: {valve}: no such state; there are {_valves(known)}")
    own = [one for one in known if not valves or one.valve in valves]
    with CheckpointFile(config.state.file) as store:
        _replace(store, own, f"replaced by an import of {file.name}")
    return [_name(one) for one in own if one.estimator not in BESIDE]


def _replace(store: CheckpointFile, own: Sequence[Checkpoint], reason: str) -> None:
    """Store states, and set aside those in their place."""
    names = {(one.valve, one.estimator) for one in own}
    there = [one for one in store.load() if (one.valve, one.estimator) in names]
    store.put_aside([(one, reason) for one in there], {})
    store.save(own)


def _chosen(aside: Sequence[SetAside], what: str, config: Config) -> list[SetAside]:
    if what.isdigit():
        found = [one for one in aside if one.number == int(what)]
    else:
        newest = {_name(one.checkpoint): one for one in aside}
        found = [one for name, one in newest.items() if what in (name, split_id(name)[0])]
    if not found:
        there = ", ".join(f"{one.number} {_name(one.checkpoint)}" for one in aside)
        raise StorageError(
            f"{config.state.file}: {what}: no such state is set aside; there are {there or 'none'}"
        )
    return found


def _no_such(config: Config, valve: str, known: Sequence[Checkpoint]) -> StorageError:
    return StorageError(
        f"{config.state.file}: {valve}: no such state; there are {_valves(known) or 'none'}"
    )


def _valves(known: Sequence[Checkpoint]) -> str:
    return ", ".join(sorted({one.valve for one in known}))


def _name(one: Checkpoint) -> str:
    return f"{one.valve}.{one.estimator}"


def _until(one: Checkpoint) -> str:
    if not one.t:
        return "no sample"
    return f"to {datetime.fromtimestamp(one.t // 1_000_000_000, UTC):%Y-%m-%dT%H:%M:%SZ}"
