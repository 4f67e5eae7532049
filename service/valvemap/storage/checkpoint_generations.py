"""Which of the stored generations of states are restored. Pure."""

from collections.abc import Collection, Sequence

from valvemap.storage.checkpoint_rows import Row
from valvemap.vocabulary.edges import split_id


def restorable(
    rows: Sequence[Row], together: Sequence[Sequence[str]]
) -> tuple[list[Row], list[str]]:
    """Return the row to restore of each (valve, estimator), and the damaged ones' names.

    The newest whole row of each is restored. If one of a valve is damaged, the valve's other rows
    are of the same earlier save, and so are those of the valves that are named ``together`` with
    it. A row that has no earlier save remains.

    Parameters
    ----------
    rows
        All rows of a file, of any generation.
    together
        Groups of names of valves; a valve is in one group at most.

    Returns
    -------
    chosen
        In order of the names.
    damaged
        ``<Valve>.<Estimator>`` whose newest row is damaged, in order.
    """
    whole = [row for row in rows if row.is_whole()]
    damaged = sorted(
        f"{row.valve}.{row.estimator}"
        for row in rows
        if not row.is_whole()
        and not any(other.name == row.name and other.saved > row.saved for other in whole)
    )
    until = _last_saves(whole, {split_id(name)[0] for name in damaged}, together)
    newest: dict[tuple[str, str], Row] = {}
    for row in sorted(whole, key=lambda row: row.saved):
        if row.saved <= until.get(row.valve, row.saved) or row.name not in newest:
            newest[row.name] = row
    return [newest[name] for name in sorted(newest)], damaged


def _last_saves(
    whole: Sequence[Row], damaged: Collection[str], together: Sequence[Sequence[str]]
) -> dict[str, int]:
    """Return the last save that counts, of each damaged valve and of those named with it."""
    newest: dict[tuple[str, str], int] = {}
    for row in whole:
        newest[row.name] = max(row.saved, newest.get(row.name, row.saved))
    groups = {valve: group for group in together for valve in group}
    until: dict[str, int] = {}
    for valve in damaged:
        group = groups.get(valve, (valve,))
        saved = [number for name, number in newest.items() if name[0] in group]
        until |= dict.fromkeys(group, min(saved, default=0))
    return until
