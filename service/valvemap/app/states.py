"""Lists, adopts, renames, exports and imports the learnt states of valves and axes."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from valvemap.app.axes import axes_file, build_axis_states
from valvemap.app.build import build_identification
from valvemap.config.models import Config
from valvemap.config.names import ALLOWED_NAME, NAME
from valvemap.errors import ConfigurationError, NoSuchFile, StorageError
from valvemap.owned_files import written_aside
from valvemap.pipeline.axis_states import OF_AXES
from valvemap.pipeline.kept_together import KeptTogether, KeptValves
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.storage.checkpoint_rows import SetAside
from valvemap.storage.checkpoints import CheckpointFile
from valvemap.storage.state_files import read_states, write_states
from valvemap.vocabulary.edges import PARTS, split_id

_OF_SERVICE: Final = "Service"  # its position and alarms are no states of a valve
_FITS: Final = "fits the configuration"
_AXIS_MARK: Final = "a"  # before the numbers of states set aside of axes, which have a file


@dataclass(frozen=True)
class _Kept:
    """A file of states and their owners; ``mark`` precedes its numbers in the list."""

    file: Path
    states: KeptTogether
    mark: str

    def stored(self) -> tuple[list[Checkpoint], list[SetAside]]:
        """Return its states but for the service's own, and those set aside."""
        stored, aside = read_states(self.file)
        return [one for one in stored if one.valve != _OF_SERVICE], aside

    def shows(self, one: Checkpoint) -> bool:
        """Whether a state is named in lists and counts."""
        return not self.states.is_beside(one.estimator)


def _kept(config: Config) -> list[_Kept]:
    """Return the files of a configuration that there are.

    Raises
    ------
    NoSuchFile
        if there is none.
    """
    found = _files(config)
    there = [one for one in found if one.file.is_file()]
    if not there:
        raise NoSuchFile(f"{found[0].file}: no such file; `valvemap serve` makes it")
    return there


def _files(config: Config) -> list[_Kept]:
    return [
        _Kept(config.state.file, KeptValves(build_identification(config)), ""),
        _Kept(axes_file(config), build_axis_states(config), _AXIS_MARK),
    ]


def list_states(config: Config) -> Iterator[str]:
    """Yield a line per state: its newest sample, and what the next start makes of it.

    Raises
    ------
    StorageError
        if a file cannot be read.
    """
    for kept in _kept(config):
        stored, aside = kept.stored()
        reviewed = kept.states.review(stored)
        _, refused = kept.states.restore(reviewed.checkpoints)
        said = {**refused, **reviewed.changes, **reviewed.set_aside}
        for one in filter(kept.shows, stored):
            name = ".".join(
                reviewed.moved.get((one.valve, one.estimator), (one.valve, one.estimator))
            )
            yield f"{_name(one)}: {_until(one)}; {said.get(name, said.get(_name(one), _FITS))}"
        for number, one, reason in aside:
            yield f"{kept.mark}{number} {_name(one)}: {_until(one)}; set aside: {reason}"


def adopt(config: Config, what: str) -> list[str]:
    """Restore states that are set aside, under the present configuration; return their names.

    ``what`` is a number that `list_states` shows, a valve or an axis, or ``<Valve>.<Estimator>``:
    the newest states of that name. The states in their place are set aside.

    Raises
    ------
    StorageError
        if there is no such state, one does not fit, or a service uses the file.
    """
    known = _kept(config)
    asides = [kept.stored()[1] for kept in known]
    for kept, aside in zip(known, asides, strict=True):
        if _chosen(kept, aside, what):
            return _adopt(kept, what)
    there = ", ".join(
        f"{kept.mark}{one.number} {_name(one.checkpoint)}"
        for kept, aside in zip(known, asides, strict=True)
        for one in aside
    )
    raise StorageError(
        f"{known[0].file}: {what}: no such state is set aside; there are {there or 'none'}"
    )


def _adopt(kept: _Kept, what: str) -> list[str]:
    with CheckpointFile(kept.file) as store:
        chosen = _chosen(kept, store.aside(), what)
        own = []
        for _, one, _ in chosen:
            meaning = kept.states.meaning_of(one.valve)
            if meaning is None:
                raise StorageError(f"{_name(one)}: no such name is configured; rename it first")
            own.append(replace(one, meaning=meaning))
        _, refused = kept.states.restore(own)
        for name, reason in refused.items():
            raise StorageError(f"{name}: {reason}")
        _replace(store, own, "replaced by an adopted state")
        store.forget_aside([number for number, _, _ in chosen])
    return [_name(one) for one in own]


def rename(config: Config, old: str, new: str) -> list[str]:
    """Give the states of a valve or an axis to another name; return their new names.

    Raises
    ------
    ConfigurationError
        if no valve can have the new name, or it is the present one.
    StorageError
        if there is no such state, or a service uses the file.
    """
    owner, _, part = new.partition(".")
    if re.fullmatch(NAME, owner) is None or part not in ("", *PARTS):
        raise ConfigurationError(f"{new!r} is no name: {ALLOWED_NAME}")
    if new == old:
        raise ConfigurationError(f"{old} has this name already")
    known = _kept(config)
    for kept in known:
        stored, aside = kept.stored()
        if any(one.valve == old for one in stored) or any(a.checkpoint.valve == old for a in aside):
            return _rename(kept, old, new)
    raise _no_such(config.state.file, old, known)


def _rename(kept: _Kept, old: str, new: str) -> list[str]:
    with CheckpointFile(kept.file) as store:
        stored = store.load()
        own = [one for one in stored if one.valve == old]
        put_away = [one for one in store.aside() if one.checkpoint.valve == old]
        there = [one for one in stored if one.valve == new]
        aside = [(one, f"replaced by the states of {old}") for one in there]
        aside += [(replace(one, valve=new), reason) for _, one, reason in put_away]
        store.put_aside(aside, {(old, one.estimator): (new, one.estimator) for one in own})
        store.forget_aside([one.number for one in put_away])
    return [f"{new}.{one.estimator}" for one in filter(kept.shows, own)]


def export_states(config: Config, file: Path, valves: Sequence[str]) -> int:
    """Write the states of the given valves and axes, or of all, to a file; return their number.

    Raises
    ------
    StorageError
        if there is no such state, or a file cannot be read or written.
    """
    known = _kept(config)
    own = [(kept, one) for kept in known for one in kept.stored()[0]]
    for valve in valves:
        if all(one.valve != valve for _, one in own):
            raise _no_such(config.state.file, valve, known)
    own = [(kept, one) for kept, one in own if not valves or one.valve in valves]
    with written_aside(file) as draft:
        write_states(draft, [one for _, one in own])
    return sum(kept.shows(one) for kept, one in own)


def import_states(config: Config, file: Path, valves: Sequence[str]) -> list[str]:
    """Store the states of an exported file; return their names. Those in their place are set aside.

    The next start compares their nodes and units with the configuration.

    Raises
    ------
    StorageError
        if there is no such state, a file cannot be used, or a service uses a state file.
    """
    given, _ = read_states(file, "valvemap state export")
    known = [one for one in given if one.valve != _OF_SERVICE]
    for valve in valves:
        if all(one.valve != valve for one in known):
            raise StorageError(f"{file}: {valve}: no such state; there are {_names(known)}")
    own = [one for one in known if not valves or one.valve in valves]
    imported = []
    for kept in _files(config):
        mine = [one for one in own if (one.estimator in OF_AXES) == (kept.mark == _AXIS_MARK)]
        if mine:
            with CheckpointFile(kept.file) as store:
                _replace(store, mine, f"replaced by an import of {file.name}")
        imported += [_name(one) for one in filter(kept.shows, mine)]
    return imported


def _replace(store: CheckpointFile, own: Sequence[Checkpoint], reason: str) -> None:
    """Store states, and set aside those in their place."""
    names = {(one.valve, one.estimator) for one in own}
    there = [one for one in store.load() if (one.valve, one.estimator) in names]
    store.put_aside([(one, reason) for one in there], {})
    store.save(own)


def _chosen(kept: _Kept, aside: Sequence[SetAside], what: str) -> list[SetAside]:
    newest = {_name(one.checkpoint): one for one in aside}
    return [one for name, one in newest.items() if what in (name, split_id(name)[0])] or [
        one for one in aside if what == f"{kept.mark}{one.number}"
    ]


def _no_such(file: Path, valve: str, known: Sequence[_Kept]) -> StorageError:
    there = [one for kept in known for one in kept.stored()[0]]
    return StorageError(f"{file}: {valve}: no such state; there are {_names(there) or 'none'}")


def _names(known: Sequence[Checkpoint]) -> str:
    return ", ".join(sorted({one.valve for one in known}))


def _name(one: Checkpoint) -> str:
    return f"{one.valve}.{one.estimator}"


def _until(one: Checkpoint) -> str:
    if not one.t:
        return "no sample"
    return f"to {datetime.fromtimestamp(one.t // 1_000_000_000, UTC):%Y-%m-%dT%H:%M:%SZ}"
