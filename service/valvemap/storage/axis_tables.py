"""The edges of an axis as a function block of IEC 61131-3, with version and checksum."""

import math
import zlib
from pathlib import Path
from typing import Final

import numpy as np

from valvemap.errors import ConfigurationError
from valvemap.model.axis_basis import WALTHER
from valvemap.model.axis_inverse import HALVES, AxisTable
from valvemap.model.kernels.axis_edges import ROOT
from valvemap.model.kernels.axis_oil import KELVIN, WALTHER_SHIFT
from valvemap.owned_files import write_whole
from valvemap.storage.table_text import FINITE, STATUSES, c_numbers, in_a_comment, literal
from valvemap.vocabulary.edges import EDGES

_SUFFIX: Final = ".st"
_DIGITS: Final = 12  # of a literal
_LN_10, _HIGH, _FALL = (
    float(literal(x)) for x in (math.log(10.0), math.log(10.0) * WALTHER[0], WALTHER[1])
)
_AT_40: Final = math.exp(_LN_10 * math.exp(_HIGH - _FALL * math.log(40.0 + KELVIN))) - WALTHER_SHIFT
"""mm²/s; viscosity of the oil at 40 °C, as `leakage_share` has it, by the block's own literals."""


def write_axis_table(file: Path, table: AxisTable, title: str, version: int) -> None:
    """Write the function block of an axis to a .st file.

    Raises
    ------
    ConfigurationError
        if the file's name does not end in .st.
    StorageError
        if it cannot be written; names it.
    """
    if file.suffix.lower() != _SUFFIX:
        raise ConfigurationError(f"{file}: an axis is exported to a name that ends in {_SUFFIX}")
    write_whole(file, axis_block(table, title, version))


def checksum(table: AxisTable) -> int:
    """Return the CRC-32 of the block's numbers: literals, joined by commas, in its order."""
    numbers = [table.y, *table.K, *table.departure, table.known, [table.leakage]]
    return zlib.crc32(",".join(literal(float(x)) for part in numbers for x in part).encode())


def axis_block(table: AxisTable, title: str, version: int) -> str:
    """Return the function block: inputs v, pA, pB, pS, pT, T; outputs U, Status, Version, Crc.

    It computes what :func:`~valvemap.model.axis_inverse.invert` computes at mid-stroke.
    """
    n, g = len(table.y), table.geometry
    V_A = g.dead_A_l + 0.5e-4 * g.A_A * g.stroke_mm
    V_B = g.dead_B_l + 0.5e-4 * g.A_B * g.stroke_mm
    meanings = ", ".join(f"{code} {name}" for name, code in STATUSES.items() if name in _USED)
    arrays = "\n".join(
        f"    {name} : ARRAY[0..{len(values) - 1}] OF LREAL := [\n{c_numbers(values)}\n    ];"
        for name, values in (
            ("Y", table.y),
            *((f"K{edge}", table.K[k]) for k, edge in enumerate(EDGES)),
            *((f"D{edge}", table.departure[k]) for k, edge in enumerate(EDGES)),
        )
    )
    known = [float(np.round(x, _DIGITS)) for x in table.known]
    return f"""(* {in_a_comment(title)}

   Signal U in % that gives a cylinder the speed v in mm/s (above 0: extends) at the pressures of
   its lines, of supply and tank, in bar, and at the oil's temperature T in °C, which changes the
   leakage: an input that is not wired has the 40 °C of the table. Version {version}, CRC
   {checksum(table)} over the literals of Y, KPA, KAT, KPB, KBT, DPA, DAT, DPB, DBT, of the last
   known positions and of the leakage.
   U is the middle of the loop of {literal(table.play_percent)} %: add half of it while U rises,
   subtract half of it while U falls.

   Status: {meanings}.
   With UNIDENTIFIED and NOT_FINITE U keeps its value. *)
FUNCTION_BLOCK FB_AxisRequiredU
VAR_INPUT
    v : LREAL;
    pA : LREAL;
    pB : LREAL;
    pS : LREAL;
    pT : LREAL;
    T : LREAL := 40.0;
END_VAR
VAR_OUTPUT
    U : LREAL;
    Status : INT;
    Version : LREAL;
    Crc : LREAL;
END_VAR
VAR
{arrays}
    thin : LREAL;
    gap : LREAL;
    wanted : LREAL;
    need : LREAL;
    sA : LREAL;
    sB : LREAL;
    dA : LREAL;
    dB : LREAL;
    low : LREAL;
    high : LREAL;
    known : LREAL;
    share : LREAL;
    Halves : ARRAY[0..{len(HALVES) - 1}] OF INT := [
        {", ".join(map(str, HALVES))}
    ];
    step : INT;
    i : INT;
    j : INT;
END_VAR

Version := {literal(float(version))};
Crc := {checksum(table)}.0;
Status := 0;
IF NOT ((v >= -{FINITE}) AND (v <= {FINITE}) AND (pA >= -{FINITE}) AND (pA <= {FINITE})
    AND (pB >= -{FINITE}) AND (pB <= {FINITE}) AND (pS >= -{FINITE}) AND (pS <= {FINITE})
    AND (pT >= -{FINITE}) AND (pT <= {FINITE})) THEN
    Status := {STATUSES["NOT_FINITE"]};
ELSE
    thin := 1.0;
    IF (T > -50.0) AND (T < 200.0) THEN
        thin := {literal(_AT_40)}
            / (EXP({literal(_LN_10)} * EXP({literal(_HIGH)}
            - {literal(_FALL)} * LN(T + {literal(KELVIN)}))) - {literal(WALTHER_SHIFT)});
    END_IF;
    gap := {literal(table.leakage)} * thin * (pA - pB);
    wanted := {literal(g.A_A / V_A)} * ({literal(6e-3 * g.A_A)} * v + gap)
        + {literal(g.A_B / V_B)} * ({literal(6e-3 * g.A_B)} * v + gap);
    IF wanted >= 0.0 THEN
        need := wanted;
        dA := pS - pA;
        dB := pB - pT;
        known := {literal(min(known[0], known[3]))};
    ELSE
        need := -wanted;
        dA := pA - pT;
        dB := pS - pB;
        known := {literal(min(known[1], known[2]))};
    END_IF;
    IF dA >= 0.0 THEN
        sA := SQRT(dA);
    ELSE
        sA := -SQRT(-dA);
    END_IF;
    IF dB >= 0.0 THEN
        sB := SQRT(dB);
    ELSE
        sB := -SQRT(-dB);
    END_IF;
    dA := ABS(sA) / {literal(ROOT)} - 1.0;
    dB := ABS(sB) / {literal(ROOT)} - 1.0;
    sA := {literal(g.A_A / V_A)} * sA;
    sB := {literal(g.A_B / V_B)} * sB;

    i := 0;
    step := 0;
    WHILE step < {len(HALVES)} DO
        IF i + Halves[step] <= {n - 2} THEN
            j := i + Halves[step];
            IF wanted >= 0.0 THEN
                low := sA * (KPA[j] + DPA[j] * dA) + sB * (KBT[j] + DBT[j] * dB);
            ELSE
                low := sA * (KAT[j] + DAT[j] * dA) + sB * (KPB[j] + DPB[j] * dB);
            END_IF;
            IF low < need THEN
                i := j;
            END_IF;
        END_IF;
        step := step + 1;
    END_WHILE;
    IF wanted >= 0.0 THEN
        low := sA * (KPA[i] + DPA[i] * dA) + sB * (KBT[i] + DBT[i] * dB);
        high := sA * (KPA[i + 1] + DPA[i + 1] * dA) + sB * (KBT[i + 1] + DBT[i + 1] * dB);
    ELSE
        low := sA * (KAT[i] + DAT[i] * dA) + sB * (KPB[i] + DPB[i] * dB);
        high := sA * (KAT[i + 1] + DAT[i + 1] * dA) + sB * (KPB[i + 1] + DPB[i + 1] * dB);
    END_IF;

    IF known <= 0.0 THEN
        Status := {STATUSES["UNIDENTIFIED"]};
    ELSE
        IF high < need THEN
            U := {literal(float(table.y[-1]))};
            Status := {STATUSES["ABOVE_REACH"]};
        ELSIF need <= 0.0 THEN
            U := 0.0;
        ELSIF high > low THEN
            share := LIMIT(0.0, (need - low) / (high - low), 1.0);
            U := Y[i] + share * (Y[i + 1] - Y[i]);
        ELSE
            U := Y[i];
        END_IF;
        IF (Status = 0) AND (U > known) THEN
            Status := {STATUSES["EXTRAPOLATING"]};
        END_IF;
        IF wanted < 0.0 THEN
            U := -U;
        END_IF;
    END_IF;
END_IF;
END_FUNCTION_BLOCK
"""


_USED: Final = frozenset({"OK", "ABOVE_REACH", "UNIDENTIFIED", "NOT_FINITE", "EXTRAPOLATING"})
