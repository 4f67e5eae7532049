"""Lookup tables for controllers in IEC 61131-3 Structured Text."""

import numpy as np
from numpy.typing import NDArray

from valvemap.model.lookup_table import LookupTable
from valvemap.storage.table_text import (
    FINITE,
    INVALID,
    STATUSES,
    c_numbers,
    error_text,
    grounds,
    in_a_comment,
    without_nan,
)


def as_structured_text(table: LookupTable, title: str) -> str:
    """Return a function block of IEC 61131-3 (3rd edition): inputs Q, dp; outputs U, Status."""
    n_r, n_dp = len(table.r), len(table.dp)
    meanings = ", ".join(f"{code} {name}" for name, code in STATUSES.items())
    return f"""(* {in_a_comment(title)}

   Inverse flow map of a hydraulic valve: control voltage U in % from flow Q in l/min and pressure
   drop dp in bar, for oil at {table.T:g} degrees Celsius. The table is over dp and over the flow as
   a share of the valve's reach at that dp, r = (Q - lowest)/(highest - lowest), and interpolated
   bilinearly: U is within {error_text(table.error_U)} % of the identified map's inverse, and the
   flow within {error_text(table.error_Q)} l/min, {grounds(table)}.
   Where nothing was measured near, the map is extrapolated: U is a guess, and Status
   {STATUSES["EXTRAPOLATING"]}.

   Status: {meanings}.
   With UNIDENTIFIED and NOT_FINITE U keeps its value; outside the axis of dp U is that of its
   nearest end.
   In the table {INVALID:.1f} means that no U can be trusted. *)
FUNCTION_BLOCK FB_ValveRequiredU
VAR_INPUT
    Q : LREAL;
    dp : LREAL;
END_VAR
VAR_OUTPUT
    U : LREAL;
    Status : INT;
END_VAR
VAR
    AxisDp : ARRAY[0..{n_dp - 1}] OF LREAL := [
{c_numbers(table.dp)}
    ];
    Lowest : ARRAY[0..{n_dp - 1}] OF LREAL := [
{c_numbers(table.lowest)}
    ];
    Highest : ARRAY[0..{n_dp - 1}] OF LREAL := [
{c_numbers(table.highest)}
    ];
    AxisR : ARRAY[0..{n_r - 1}] OF LREAL := [
{c_numbers(table.r)}
    ];
    TableU : ARRAY[0..{n_r * n_dp - 1}] OF LREAL := [
{c_numbers(without_nan(table.U).ravel())}
    ];
    Guess : ARRAY[0..{n_r * n_dp - 1}] OF INT := [
{_st_marks(table.guessed)}
    ];
    y : LREAL;
    a : LREAL;
    b : LREAL;
    r : LREAL;
    QLow : LREAL;
    QHigh : LREAL;
    i : INT;
    j : INT;
    k : INT;
END_VAR

Status := 0;
IF NOT ((Q >= -{FINITE}) AND (Q <= {FINITE}) AND (dp >= -{FINITE}) AND (dp <= {FINITE})) THEN
    Status := {STATUSES["NOT_FINITE"]};
ELSE
    y := LIMIT(AxisDp[0], dp, AxisDp[{n_dp - 1}]);
    IF y <> dp THEN
        Status := {STATUSES["OUTSIDE"]};
    END_IF;

    j := 0;
    WHILE (j < {n_dp - 2}) AND (AxisDp[j + 1] <= y) DO
        j := j + 1;
    END_WHILE;
    b := (y - AxisDp[j]) / (AxisDp[j + 1] - AxisDp[j]);
    QLow := (1.0 - b) * Lowest[j] + b * Lowest[j + 1];
    QHigh := (1.0 - b) * Highest[j] + b * Highest[j + 1];
    IF QHigh > QLow THEN
        r := (Q - QLow) / (QHigh - QLow);
    ELSE
        r := 0.0;
        Status := {STATUSES["UNIDENTIFIED"]};
    END_IF;
    i := 0;
    WHILE (i < {n_r - 2}) AND (AxisR[i + 1] <= r) DO
        i := i + 1;
    END_WHILE;
    k := i * {n_dp} + j;
    IF (Status = 0)
        AND (Guess[k] + Guess[k + 1] + Guess[k + {n_dp}] + Guess[k + {n_dp + 1}] > 0) THEN
        Status := {STATUSES["EXTRAPOLATING"]};
    END_IF;

    IF r > 1.0 THEN
        U := 100.0;
        IF Status = 0 THEN
            Status := {STATUSES["ABOVE_REACH"]};
        END_IF;
    ELSIF r < 0.0 THEN
        U := 0.0;
        IF Status = 0 THEN
            Status := {STATUSES["BELOW_REACH"]};
        END_IF;
    ELSE
        IF (TableU[k] <= {INVALID:.1f}) OR (TableU[k + 1] <= {INVALID:.1f})
            OR (TableU[k + {n_dp}] <= {INVALID:.1f})
            OR (TableU[k + {n_dp + 1}] <= {INVALID:.1f}) THEN
            IF Status <> {STATUSES["OUTSIDE"]} THEN
                Status := {STATUSES["UNIDENTIFIED"]};
            END_IF;
        ELSE
            a := (r - AxisR[i]) / (AxisR[i + 1] - AxisR[i]);
            U := (1.0 - a) * ((1.0 - b) * TableU[k] + b * TableU[k + 1])
                + a * ((1.0 - b) * TableU[k + {n_dp}] + b * TableU[k + {n_dp + 1}]);
        END_IF;
    END_IF;
END_IF;
END_FUNCTION_BLOCK
"""


def _st_marks(guessed: NDArray[np.bool_], per_line: int = 24) -> str:
    texts = [str(int(x)) for x in guessed.ravel()]
    lines = [texts[k : k + per_line] for k in range(0, len(texts), per_line)]
    return ",\n".join("        " + ", ".join(line) for line in lines)
