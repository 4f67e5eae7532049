"""Restores stored states at the start, keeps the others aside, and logs what became of each."""

from collections.abc import Mapping, Sequence

import structlog

from valvemap.pipeline.kept_together import KeptTogether
from valvemap.pipeline.review import Reviewed
from valvemap.pipeline.store_ports import Checkpoint, CheckpointStore

NAMED = 8  # valves and estimators named in one log line; the rest are counted
REMEDY = "`valvemap state list` lists them, `valvemap state adopt` restores one"

log = structlog.get_logger(__name__)


def restore(
    states: KeptTogether, store: CheckpointStore, stored: Sequence[Checkpoint]
) -> dict[str, str]:
    """Restore the states that fit the configuration; return the reasons for the others, by name.

    Raises
    ------
    StorageError
        if states cannot be set aside: the next save would replace them.
    """
    reviewed = states.review(stored)
    restored, refused = states.restore(reviewed.checkpoints)
    _put_aside(states, store, reviewed, refused)
    if store.damaged:
        log.warning("checkpoints damaged, earlier ones restored", estimators=_named(store.damaged))
    if restored:
        log.info("checkpoints restored", estimators=_named(restored))
    if reviewed.changes:
        log.warning(
            "configuration changed, checkpoints are converted", what=by_reason(reviewed.changes)
        )
    return {**refused, **reviewed.set_aside}


def _put_aside(
    states: KeptTogether,
    store: CheckpointStore,
    reviewed: Reviewed,
    refused: Mapping[str, str],
) -> None:
    """Keep every stored state that is not restored and that the next save would replace."""
    aside = [(one.checkpoint, one.reason) for one in reviewed.aside]
    for one in reviewed.checkpoints:
        reason = refused.get(f"{one.valve}.{one.estimator}")
        if reason is not None and states.replaces(one):
            aside.append((one, reason))
    store.put_aside(aside, reviewed.moved)


def by_reason(refused: Mapping[str, str]) -> str:
    """Return each reason once, with the first names it applies to."""
    lines = []
    for reason in dict.fromkeys(refused.values()):
        names = [name for name, why in refused.items() if why == reason]
        lines.append(f"{_named(names)}: {reason}")
    return "; ".join(lines)


def _named(names: Sequence[str]) -> str:
    """Return the first names, and the number of the others."""
    rest = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"{', '.join(names[:NAMED])}{rest}"
