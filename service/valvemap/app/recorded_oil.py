"""The unit of a recording's oil temperature, judged by its values."""

from pathlib import Path
from typing import Final

import numpy as np

from valvemap.errors import RecordingError
from valvemap.model.samples import Samples

HOTTEST: Final = 200.0  # °C; mineral oil flashes at about as much
COLDEST: Final = -80.0  # °C; hydraulic oil is solid
ZERO_K: Final = 273.15  # K


def check_oil(file: Path, valve: str, samples: Samples, *, configured: bool, insist: str) -> None:
    """Check a valve's first samples; T that was never measured is none to check.

    Raises
    ------
    RecordingError
        if the oil cannot have that temperature; names the remedy.
    """
    T = samples.T[np.isfinite(samples.T)]
    if not len(T) or COLDEST < (median := float(np.median(T))) < HOTTEST:
        return
    said = f"{file}: valve {valve}: T is {T.min():.4g} … {T.max():.4g} °C, which no oil has"
    if COLDEST < median - ZERO_K < HOTTEST:
        remedy = "--scale T=K (units={'T': 'K'} in Python)"
        remedy = 'signals.T.unit = "K" in the configuration' if configured else remedy
        raise RecordingError(f"{said}: if it is in K, {remedy} says so; {insist}")
    raise RecordingError(
        f"{said}: state its unit, or its raw numbers and values, such as --scale "
        f"T=0..27648:0..100°C, or leave the column T out; {insist}"
    )
