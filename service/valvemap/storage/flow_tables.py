"""Tables over flow and pressure drop as CSV, for a spreadsheet."""

from pathlib import Path

import numpy as np

from valvemap.model.flow_table import FlowTable
from valvemap.owned_files import write_whole
from valvemap.storage.table_text import in_a_comment, literal, stated


def write_flow_table(file: Path, table: FlowTable, title: str) -> None:
    """Write a table.

    Raises
    ------
    StorageError
        if the file cannot be written; names it.
    """
    write_whole(file, as_csv(table, title))


def as_csv(table: FlowTable, title: str) -> str:
    r"""Return the table as CSV: U, a row per flow and a column per pressure drop.

    Cells without a value are empty. The last rows, over the same axes, are 1 where the map is
    extrapolated.

    >>> axis, at = np.array([0.0, 1.0]), np.array([[False, True], [False, False]])
    >>> print(as_csv(FlowTable(9 * axis, axis, np.eye(2), at, 40.0, 0.1, 0.2), "V"))
    # V; oil at 40 °C; U in % over Q in l/min (rows) and dp in bar (columns)
    # bilinearly, limited to 0 … 100 %: 0.1 % of U, 0.2 l/min of Q, measured at 49 points a cell
    Q/dp,0.0,1.0
    0.0,1.0,0.0
    9.0,0.0,1.0
    extrapolated,0.0,1.0
    0.0,0,1
    9.0,0,0
    <BLANKLINE>
    """
    axis = ",".join(map(literal, table.dp))
    axes = "U in % over Q in l/min (rows) and dp in bar (columns)"
    lines = [
        f"# {in_a_comment(title)}; oil at {table.T:g} °C; {axes}",
        f"# bilinearly, limited to 0 … 100 %: {stated(table)}",
        f"Q/dp,{axis}",
    ]
    for Q, row in zip(table.Q, table.U, strict=True):
        lines.append(",".join([literal(Q), *("" if np.isnan(x) else literal(x) for x in row)]))
    lines.append(f"extrapolated,{axis}")
    for Q, marks in zip(table.Q, table.guessed, strict=True):
        lines.append(",".join([literal(Q), *(str(int(x)) for x in marks)]))
    return "\n".join(lines) + "\n"
