"""States of `kernels.flow_drift` as arrays: covariances unpacked, states of earlier versions."""

from typing import Any, Final

import numpy as np

from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.samples import Floats

VALVE_STATES: Final = (
    np.array(  # states without the sensors' levels: all that there were up to 0.2.0
        [
            *(drifts.GAIN, drifts.EDGE, drifts.RATES + drifts.GAIN, drifts.RATES + drifts.EDGE),
            *range(drifts.LEVELS, drifts.RATES),
        ]
    )
)
NEW_MODELS: Final = [drifts.SENSING, drifts.OTHER_ZERO, drifts.OTHER_PRESSURE]  # since 0.2.0

LOGARITHM: Final = np.array(  # effects of ln ν, its bend, by those of powers of ν, see `flow_oil`
    [
        [1.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 1 / 2, 1.0, 0.0, 0.0],  # √ν - 1 = x/2 + x²/8 + …
        [0.0, 1 / 8, 1 / 2, 0.0, 0.0],  # ν - 1 = x + x²/2 + …
        [0.0, 0.0, 0.0, 1 / 2, 0.0],
        [0.0, 0.0, 0.0, 0.0, 1.0],
    ]
)


def drifting(chance: Floats) -> Floats:
    """Probability that a level drifts, of each filter (…,)."""
    return np.asarray(chance[..., drifts.MOVING : drifts.SENSING + 1].sum(axis=-1))


def covariance(P: Floats, m: int) -> Floats:
    """Return that of a model (STATES, STATES)."""
    n, found = drifts.SIZES[m], np.zeros((drifts.STATES, drifts.STATES))
    lower = np.tril_indices(n)
    found[lower] = P[drifts.PLACES[m] : drifts.PLACES[m] + n * (n + 1) // 2]
    return found + np.tril(found, -1).T


def upgrade(arrays: dict[str, Any], prefix: str = "") -> None:
    """Insert the sensors' offsets, which earlier versions did not know."""
    old = {name: arrays[prefix + name] for name in ("x", "P", "chance", "now")}
    sides, n = len(old["x"]), drifts.STATES
    models = np.delete(np.arange(drifts.MODELS), NEW_MODELS)
    x, P = np.zeros((sides, drifts.MODELS, n)), np.zeros((sides, drifts.PACKED))
    chance, now = (
        np.zeros((sides, drifts.MODELS)),
        np.zeros((sides, 1 + drifts.SHOWN, drifts.SHOWN)),
    )
    chance[:, models] = old["chance"]
    x[np.ix_(np.arange(sides), models, VALVE_STATES)] = old["x"]
    x[:, NEW_MODELS] = x[:, [drifts.STILL]]
    now[np.ix_(np.arange(sides), np.append(0, 1 + VALVE_STATES), VALVE_STATES)] = old["now"]
    for side in range(sides):
        for m in range(drifts.MODELS):
            before = drifts.STILL if m in NEW_MODELS else int(np.searchsorted(models, m))
            whole = np.zeros((n, n))
            whole[np.ix_(VALVE_STATES, VALVE_STATES)] = old["P"][side, before]
            lower, at = np.tril_indices(drifts.SIZES[m]), drifts.PLACES[m]
            P[side, at : at + len(lower[0])] = whole[lower]
    arrays |= {prefix + "x": x, prefix + "P": P, prefix + "chance": chance, prefix + "now": now}


def by_logarithm(arrays: dict[str, Any]) -> None:
    """Let effects of T be those of ln ν, which earlier versions had of ν - 1 and √ν - 1."""
    arrays["x"] = arrays["x"] @ _logarithm(drifts.STATES).T
    arrays["now"] = moving_by_logarithm(arrays["now"])
    for P in arrays["P"]:
        for m, (n, at) in enumerate(zip(drifts.SIZES, drifts.PLACES, strict=True)):
            whole, other = covariance(P, m), _logarithm(drifts.STATES)
            P[at : at + n * (n + 1) // 2] = (other @ whole @ other.T)[np.tril_indices(n)]


def moving_by_logarithm(moving: Floats) -> Floats:
    """Return means and covariances (…, 1 + n, n) of the states that `by_logarithm` gives."""
    other = _logarithm(moving.shape[-1])
    mean, whole = moving[..., :1, :], moving[..., 1:, :]
    return np.concatenate([mean @ other.T, other @ whole @ other.T], axis=-2)


def _logarithm(n: int) -> Floats:
    """Return what takes n states to those of ln ν: effects of T are at the same places in all."""
    other = np.eye(n)
    other[drifts.LEVELS : drifts.RATES, drifts.LEVELS : drifts.RATES] = LOGARITHM
    return other


def add_jumps_of_offsets(arrays: dict[str, Any], prefix: str = "") -> None:
    """Insert the models in which an offset jumps."""
    x, P, chance = (arrays[prefix + name] for name in ("x", "P", "chance"))
    new, still = drifts.OTHER_ZERO, slice(drifts.PLACES[drifts.STILL + 1])
    many = 2 * (still.stop or 0)
    arrays |= {
        prefix + "x": np.insert(x, [new, new], x[:, [drifts.STILL] * 2], axis=1),
        prefix + "P": np.insert(P, [drifts.PLACES[new]] * many, np.tile(P[:, still], 2), axis=1),
        prefix + "chance": np.insert(chance, [new, new], 0.0, axis=1),
    }
