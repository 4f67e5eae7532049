"""A valve's dynamics from its recording."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from valvemap.app.valve_samples import samples_of
from valvemap.errors import RecordingError
from valvemap.model.dynamics import Dynamics, NotFitted, Quantity, fit_dynamics
from valvemap.storage.layout import Layout
from valvemap.vocabulary.dynamics import DYNAMIC_QUANTITIES


def dynamics_of(valve: str, file: Path, layout: Layout | None) -> Dynamics:
    """Fit the dynamics of a valve to a recording.

    Raises
    ------
    RecordingError
        naming the file, and why it tells no dynamics.
    ConfigurationError, StorageError
    """
    found = fit_dynamics(samples_of(valve, file, layout))
    if isinstance(found, NotFitted):
        raise RecordingError(f"{file}: {found.sentence}")
    return found


def as_json(valve: str, file: Path, found: Dynamics) -> dict[str, Any]:
    """Return what ``--json`` writes; null where there is no value."""
    t, x = found.step_response()
    f = np.geomspace(0.05, 5.0, 100) * found.natural_frequency.value
    dB, degrees = found.frequency_response(f)
    return {
        "valve": valve,
        "recording": file.name,
        "quantities": {
            quantity.name: _quantity(getattr(found, quantity.field), quantity.unit)
            for quantity in DYNAMIC_QUANTITIES
        },
        "step_percent": found.step_percent,
        "U_between_samples": found.hold.value,
        "play_percent": found.play_percent,
        "residual_std": found.noise,
        "step_response": None if math.isnan(x[-1]) else {"t": t.tolist(), "x": x.tolist()},
        "frequency_response": None
        if math.isnan(dB[-1])
        else {"f": f.tolist(), "dB": dB.tolist(), "degrees": degrees.tolist()},
    }


def _quantity(found: Quantity, unit: str) -> dict[str, Any]:
    has_value = math.isfinite(found.value)
    return {
        "value": found.value if has_value else None,
        "std": found.std if has_value else None,
        "unit": unit,
        "status": found.status.name,
    }
