"""Lookup tables for controllers: C99 and IEC 61131-3 Structured Text."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from valvemap.errors import ConfigurationError
from valvemap.model.lookup_table import LookupTable
from valvemap.owned_files import write_whole
from valvemap.storage.structured_text import as_structured_text
from valvemap.storage.table_text import (
    INVALID,
    STATUSES,
    c_marks,
    c_numbers,
    c_rows,
    error_text,
    grounds,
    in_a_comment,
)

CSV: Final = ".csv"  # of a table over flow and pressure drop, see `flow_tables`
UNIT: Final = ".fmu"  # of an FMI unit, see `fmi_units`


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
 * VALVEMAP_ERROR_Q l/min, {grounds(table)}.
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


_FORMS: Final[Mapping[str, Callable[[LookupTable, str], str]]] = {
    ".c": as_c,
    ".st": as_structured_text,
}
