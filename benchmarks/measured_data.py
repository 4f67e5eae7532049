"""Certified and measured data by others.

What its terms allow lies in ``tests/data``, with its origin and licence; the actuator and the air
valve are read from beside the repository, and where that folder is absent, their users report
it and continue.
"""

import csv
import json
import lzma
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import scipy.io
from numpy.typing import NDArray

from valvemap.model.samples import Samples

Floats = NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "tests" / "data"
ELSEWHERE = ROOT.parent / "shared" / "data"  # what may not be passed on
ABSENT = "actuator and air valve: their terms keep them out of here, ../shared/data is not there"
SECOND = 1_000_000_000  # ns


def elsewhere_is_there() -> bool:
    """Whether the data that may not be passed on lie beside the repository."""
    return ELSEWHERE.is_dir()


@dataclass(frozen=True)
class Problem:
    """A regression problem with its exact solution.

    Attributes
    ----------
    name
        As NIST calls it.
    X, y : (N, n), (N,)
        Regressors and output.
    theta, std : (n,)
        The solution and its standard deviations, exact.
    """

    name: str
    X: Floats
    y: Floats
    theta: tuple[Fraction, ...]
    std: tuple[Fraction, ...]


def nist_problems() -> tuple[Problem, ...]:
    """NIST StRD, linear regression: seven sets with solutions exact to 36 digits."""
    text = (FOLDER / "nist" / "nist_strd_linear_regression.json").read_text("utf-8")
    return tuple(_problem(name, entry) for name, entry in json.loads(text).items())


def _problem(name, entry) -> Problem:
    x = np.array(entry["x"], np.float64)
    first = 0 if entry["intercept"] else 1
    if entry["degree"] is None:
        X = np.column_stack([np.ones(len(x)), x])
    else:
        X = np.column_stack([x**k for k in range(first, entry["degree"] + 1)])
    exact = {
        key: tuple(Fraction(digits) for digits in entry[f"exact_{key}"]) for key in ("beta", "se")
    }
    return Problem(name, X, np.array(entry["y"], np.float64), exact["beta"], exact["se"])


@dataclass(frozen=True)
class Strucchange:
    """Recursive residuals of cpi ~ 1 + m1, United States 1959 to 2009, by R's strucchange.

    Attributes
    ----------
    X, y : (203, 2), (203,)
        Regressors and output.
    exact : (203, 2) of Fraction
        The same, without rounding to binary.
    theta, residuals : (201, 2), (201,)
        R's parameters after samples 2, 3 …, and its residual of each, e/√(1 + XᵀPX).
    """

    X: Floats
    y: Floats
    exact: list[tuple[Fraction, Fraction]]
    theta: Floats
    residuals: Floats


def strucchange() -> Strucchange:
    """R's figures as statsmodels ships them; row k belongs to the first k + 3 samples."""
    macro = _rows("macrodata.csv")
    by_R = _rows("results_rls_R.csv")
    m1 = np.array([row["m1"] for row in macro], np.float64)
    return Strucchange(
        X=np.column_stack([np.ones(len(m1)), m1]),
        y=np.array([row["cpi"] for row in macro], np.float64),
        exact=[(Fraction(row["m1"]), Fraction(row["cpi"])) for row in macro],
        theta=np.array([(row["beta1"], row["beta2"]) for row in by_R], np.float64),
        residuals=np.array([row["rec_resid"] for row in by_R], np.float64),
    )


def _rows(name):
    with (FOLDER / "statsmodels_rls" / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def cooling_circuit() -> Samples:
    """Cooling circuit of the ZeMA rig, 2205 cycles of 60 s at 1 Hz; there is no valve: U is 100 %.

    FS2 (l/min), PS5, PS6 (bar), TS4 (°C); Helwig, Pignanelli, Schütze 2015, CC BY 4.0.
    """
    Q = _channel("FS2.1hz.tsv.xz")
    return Samples.of(
        t=np.arange(len(Q), dtype=np.int64) * SECOND,
        U=np.full(len(Q), 100.0),
        p1=_channel("PS5.1hz.tsv.xz"),
        p2=_channel("PS6.1hz.tsv.xz"),
        Q=Q,
        T=_channel("TS4.txt.xz"),
    )


def _channel(name) -> Floats:
    with lzma.open(FOLDER / "uci_hydraulic_rig" / name, "rt") as file:
        return np.array(file.read().split(), np.float64)


@dataclass(frozen=True)
class Dynamics:
    """Input and output of a dynamic system, (N,) each."""

    u: Floats
    y: Floats


def actuator() -> Dynamics:
    """Hydraulic actuator: opening u of its valve, oil pressure y, 1024 samples, no units."""
    arrays = scipy.io.loadmat(ELSEWHERE / "actuator" / "actuator.mat")
    return Dynamics(*(np.ascontiguousarray(arrays[key].ravel(), np.float64) for key in "up"))


def air_valve() -> Samples:
    """Festo MPYE from its middle to its end, air from 6 to 5 bar, 40 points, Q in l/min.

    U is 0 % in the middle (5 V), 100 % at 10 V. Zhu, thesis, Vanderbilt University 2006, table 2-2.
    """
    path = ELSEWHERE / "proportional_valve_air" / "zhu2006_table2-2_valve_data.csv"
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    volts, Q = table[:, 0], table[:, 5]
    return Samples.of(
        t=np.arange(len(Q), dtype=np.int64) * SECOND,
        U=100.0 * (volts - 5.0) / 5.0,
        p1=np.full(len(Q), 6.0),
        p2=np.full(len(Q), 5.0),
        Q=Q,
        T=np.full(len(Q), 20.0),
    )
