"""Reads demands from CSV and writes the results of the inverse map to CSV."""

import csv
import io
from pathlib import Path

import numpy as np

from valvemap.errors import NoSuchFile, StorageError
from valvemap.model.inversion import Inversion
from valvemap.model.samples import Floats
from valvemap.owned_files import written_aside
from valvemap.vocabulary.statuses import InverseStatus

_SEPARATORS = ",;\t"  # of equal counts, the first is taken
Points = tuple[Floats, Floats, Floats]


def read_points(file: Path) -> Points:
    """Read Q (l/min), dp (bar) and T (°C, NaN if missing), each (N,), from a CSV file.

    The first line names the columns: Q, dp and optionally T, in any order; others are ignored.
    Columns are separated by commas, semicolons or tabs; without commas between them, a comma is
    the decimal mark.

    Raises
    ------
    StorageError
        if a value is invalid; names file, line, column and value.
    """
    try:
        text = file.read_text(encoding="utf-8-sig")
        separator = max(_SEPARATORS, key=text.partition("\n")[0].count)
        lines = list(csv.reader(io.StringIO(text), delimiter=separator))
    except FileNotFoundError:
        raise NoSuchFile(f"{file}: no such file; lines of Q,dp or Q,dp,T are wanted") from None
    except OSError as error:
        raise StorageError(f"{file}: {(error.strerror or str(error)).lower()}") from None
    except (UnicodeDecodeError, csv.Error):
        raise StorageError(f"{file}: not a CSV file in UTF-8") from None
    header = [name.strip() for name in lines[0]] if lines else []
    for name in ("Q", "dp"):
        if name not in header:
            raise StorageError(f"{file}: line 1: no column {name}; Q, dp and perhaps T are wanted")
    if separator != ",":
        lines = [[cell.replace(",", ".") for cell in row] for row in lines]
    rows = [(number, row) for number, row in enumerate(lines[1:], start=2) if any(row)]
    Q, dp = (_column(file, header.index(name), name, rows) for name in ("Q", "dp"))
    if "T" not in header:
        return Q, dp, np.full_like(Q, np.nan)
    return Q, dp, _column(file, header.index("T"), "T", rows)


def write_answers(file: Path, points: Points, answer: Inversion) -> None:
    """Write Q, dp, T, U, its 95 % interval and status, a line per point; unknown cells are empty.

    Raises
    ------
    StorageError
        if the file cannot be written; names it.
    """
    columns = (*points, answer.U, answer.lower, answer.upper)
    with written_aside(file) as draft, draft.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(["Q", "dp", "T", "U", "lower", "upper", "status"])
        for *numbers, status in zip(*columns, answer.status, strict=True):
            texts = ["" if np.isnan(x) else repr(float(x)) for x in numbers]
            writer.writerow([*texts, InverseStatus(status).name])


def _column(file: Path, place: int, name: str, rows: list[tuple[int, list[str]]]) -> Floats:
    values = []
    for number, row in rows:
        text = row[place].strip() if place < len(row) else ""
        if not text and name != "T":
            raise StorageError(f"{file}: line {number}: {name} is missing")
        try:
            values.append(float(text) if text else np.nan)
        except ValueError:
            raise StorageError(
                f"{file}: line {number}: {name} = {text!r}; a number is wanted"
            ) from None
    return np.array(values, np.float64)
