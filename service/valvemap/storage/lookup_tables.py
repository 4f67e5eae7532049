"""Lookup tables for controllers: C99 and IEC 61131-3 Structured Text."""

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.errors import ConfigurationError
from valvemap.model.flow_table import FlowTable
from valvemap.model.lookup_table import LookupTable
from valvemap.model.samples import Floats
from valvemap.owned_files import write_whole

INVALID: Final = -1000.0
CSV: Final = ".csv"  # of a table over flow and pressure drop, see `flow_tables`
UNIT: Final = ".fmu"  # of an FMI unit, see `fmi_units`
FINITE: Final = "1.0e300"  # limit of finite numbers in Structured Text, which has no other test
STATUSES: Final = {
    "OK": 0,
    "ABOVE_REACH": 1,
    "BELOW_REACH": 2,
    "UNIDENTIFIED": 4,
    "NOT_FINITE": 5,
    "OUTSIDE": 6,
    "EXTRAPOLATING": 7,
}


def write_table(file: Path, table: LookupTable, title: str) -> None:
    """Write a table in the format of the file's suffix: .c or .st.

    Raises
    ------
    ConfigurationError
        if the suffix is none of these.
    StorageError
        if the file cannot be written; names it.
    """
    check_form(file)
    write_whole(file, _FORMS[file.suffix.lower()](table, title))


def check_form(file: Path) -> None:
    """Check that a file's suffix is a supported format: .csv, .c, .st or .fmu.

    Raises
    ------
    ConfigurationError
        if it is not.
    """
    allowed = CSV, *_FORMS, UNIT
    if file.suffix.lower() not in allowed:
        asked = file.suffix or "no ending"
        raise ConfigurationError(f"{file}: {asked}; {', '.join(allowed)} are allowed")


def as_c(table: LookupTable, title: str) -> str:
    """Return one C99 file without dependencies: ``valvemap_required_U(Q, dp, &U)``."""
    statuses = ", ".join(f"VALVEMAP_{name} = {code}" for name, code in STATUSES.items())
    return f"""/* {in_a_comment(title)}
 *
 * Inverse flow map of a hydraulic valve: control voltage U in % from flow Q in l/min and pressure
 * drop dp in bar, for oil at {table.T:g} degrees Celsius. The table is over dp and over the flow as
 * a share of the valve's reach at that dp, r = (Q - lowest)/(highest - lowest), and interpolated
 * bilinearly: U is within VALVEMAP_ERROR_U % of the identified map's inverse, and the flow within
 * VALVEMAP_ERROR_Q l/min, {_grounds(table)}.
 * Where nothing was measured near, the map is extrapolated: U is a guess, and the status
 * VALVEMAP_EXTRAPOLATING.
 *
 *     double U;
 *     int status = valvemap_required_U(50.0, 100.0, &U);
 */

#define VALVEMAP_ERROR_U {error_text(table.error_U)}
#define VALVEMAP_ERROR_Q {error_text(table.error_Q)}

enum valvemap_status {{ {statuses} }};

#define VALVEMAP_INVALID ({INVALID:.1f}) /* no U can be trusted here */
#define VALVEMAP_N_R {len(table.r)}
#define VALVEMAP_N_DP {len(table.dp)}

static const double valvemap_dp[VALVEMAP_N_DP] = {{
{c_numbers(table.dp)}
}};

static const double valvemap_lowest[VALVEMAP_N_DP] = {{
{c_numbers(table.lowest)}
}};

static const double valvemap_highest[VALVEMAP_N_DP] = {{
{c_numbers(table.highest)}
}};

static const double valvemap_r[VALVEMAP_N_R] = {{
{c_numbers(table.r)}
}};

static const double valvemap_U[VALVEMAP_N_R][VALVEMAP_N_DP] = {{
{c_rows(table.U)}
}};

/* 1: extrapolated */
static const unsigned char valvemap_guess[VALVEMAP_N_R][VALVEMAP_N_DP] = {{
{c_marks(table.guessed)}
}};

/* By its bits, so that it holds under -ffast-math, too. */
static int valvemap_is_finite(double x)
{{
    union {{ double value; unsigned long long bits; }} of;
    of.value = x;
    return ((of.bits >> 52) & 0x7ff) != 0x7ff;
}}

static int valvemap_place(const double *axis, int n, double x)
{{
    int low = 0, high = n - 1;
    while (high - low > 1) {{
        int middle = (low + high) / 2;
        if (axis[middle] <= x)
            low = middle;
        else
            high = middle;
    }}
    return low;
}}

/* U in 0 ... 100 %; outside the axis of dp that of its nearest end. Returns an enum
 * valvemap_status; with UNIDENTIFIED and NOT_FINITE *U is left as it was. */
int valvemap_required_U(double Q, double dp, double *U)
{{
    int status = VALVEMAP_OK, i, j;
    double low, high, r, u, v;
    if (!valvemap_is_finite(Q) || !valvemap_is_finite(dp))
        return VALVEMAP_NOT_FINITE;
    if (dp < valvemap_dp[0] || dp > valvemap_dp[VALVEMAP_N_DP - 1]) {{
        status = VALVEMAP_OUTSIDE;
        dp = dp < valvemap_dp[0] ? valvemap_dp[0] : valvemap_dp[VALVEMAP_N_DP - 1];
    }}
    j = valvemap_place(valvemap_dp, VALVEMAP_N_DP, dp);
    v = (dp - valvemap_dp[j]) / (valvemap_dp[j + 1] - valvemap_dp[j]);
    low = (1.0 - v) * valvemap_lowest[j] + v * valvemap_lowest[j + 1];
    high = (1.0 - v) * valvemap_highest[j] + v * valvemap_highest[j + 1];
    if (!(high > low))
        return VALVEMAP_UNIDENTIFIED;
    r = (Q - low) / (high - low);
    i = valvemap_place(valvemap_r, VALVEMAP_N_R, r);
    if (status == VALVEMAP_OK
        && (valvemap_guess[i][j] || valvemap_guess[i][j + 1]
            || valvemap_guess[i + 1][j] || valvemap_guess[i + 1][j + 1]))
        status = VALVEMAP_EXTRAPOLATING;
    if (r > 1.0) {{
        *U = 100.0;
        return status == VALVEMAP_OK ? VALVEMAP_ABOVE_REACH : status;
    }}
    if (r < 0.0) {{
        *U = 0.0;
        return status == VALVEMAP_OK ? VALVEMAP_BELOW_REACH : status;
    }}
    if (valvemap_U[i][j] <= VALVEMAP_INVALID || valvemap_U[i][j + 1] <= VALVEMAP_INVALID
        || valvemap_U[i + 1][j] <= VALVEMAP_INVALID || valvemap_U[i + 1][j + 1] <= VALVEMAP_INVALID)
        return status == VALVEMAP_OUTSIDE ? status : VALVEMAP_UNIDENTIFIED;
    u = (r - valvemap_r[i]) / (valvemap_r[i + 1] - valvemap_r[i]);
    *U = (1.0 - u) * ((1.0 - v) * valvemap_U[i][j] + v * valvemap_U[i][j + 1])
       + u * ((1.0 - v) * valvemap_U[i + 1][j] + v * valvemap_U[i + 1][j + 1]);
    return status;
}}
"""


def as_structured_text(table: LookupTable, title: str) -> str:
    """Return a function block of IEC 61131-3 (3rd edition): inputs Q, dp; outputs U, Status."""
    n_r, n_dp = len(table.r), len(table.dp)
    meanings = ", ".join(f"{code} {name}" for name, code in STATUSES.items())
    return f"""(* {in_a_comment(title)}

   Inverse flow map of a hydraulic valve: control voltage U in % from flow Q in l/min and pressure
   drop dp in bar, for oil at {table.T:g} degrees Celsius. The table is over dp and over the flow as
   a share of the valve's reach at that dp, r = (Q - lowest)/(highest - lowest), and interpolated
   bilinearly: U is within {error_text(table.error_U)} % of the identified map's inverse, and the
   flow within {error_text(table.error_Q)} l/min, {_grounds(table)}.
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
{c_numbers(_valid(table.U).ravel())}
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


_FORMS: Final[Mapping[str, Callable[[LookupTable, str], str]]] = {
    ".c": as_c,
    ".st": as_structured_text,
}


def stated(table: LookupTable | FlowTable) -> str:
    """Return the table's errors in words."""
    errors = error_text(table.error_U), error_text(table.error_Q)
    return f"{errors[0]} % of U, {errors[1]} l/min of Q, {_grounds(table)}"


def _grounds(table: LookupTable | FlowTable) -> str:
    return "certified over the whole table" if table.certified else "measured at 49 points a cell"


def error_text(error: float) -> str:
    """Return an error rounded up to 4 digits."""
    step = 10.0 ** (math.floor(math.log10(error)) - 3)
    return literal(float(f"{math.ceil(error / step) * step:.4g}"))


def in_a_comment(title: str) -> str:
    """Return a title without line ends and comment delimiters."""
    return "".join(c if c.isalnum() or c in " .,:;=-_%" else "_" for c in title)


def _valid(U: Floats) -> Floats:
    return np.where(np.isnan(U), INVALID, U)


def c_numbers(values: Iterable[float], per_line: int = 8) -> str:
    """Return literals with commas between."""
    texts = [literal(x) for x in values]
    lines = [texts[k : k + per_line] for k in range(0, len(texts), per_line)]
    return ",\n".join("        " + ", ".join(line) for line in lines)


def literal(x: float) -> str:
    """Return a number as a floating-point literal of both languages."""
    text = f"{x:.12g}"
    if "e" in text:
        mantissa, _, power = text.partition("e")
        return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{int(power)}"
    return text if "." in text else f"{text}.0"


def c_rows(U: Floats) -> str:
    """Return the rows of a table in braces; NaN is ``INVALID``."""
    return ",\n".join("    {\n" + c_numbers(row) + "\n    }" for row in _valid(U))


def c_marks(guessed: NDArray[np.bool_]) -> str:
    """Return the rows of a mask in braces."""
    return ",\n".join("    { " + ", ".join(str(int(x)) for x in row) + " }" for row in guessed)


def _st_marks(guessed: NDArray[np.bool_], per_line: int = 24) -> str:
    texts = [str(int(x)) for x in guessed.ravel()]
    lines = [texts[k : k + per_line] for k in range(0, len(texts), per_line)]
    return ",\n".join("        " + ", ".join(line) for line in lines)
