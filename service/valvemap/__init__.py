"""valvemap for scripts and notebooks: the public names, each loaded on first use.

These names are stable. Modules and names below them may change with any release.

Estimators on arrays:

`recursive_least_squares`, `recursive_maximum_likelihood`
    Parameters theta with history, innovations and covariance: from regressors X (N, n) and output
    y (N,), or from output y and inputs u.
`FlowMapRegressor`
    The flow map as a scikit-learn estimator (extra ``sklearn``).
`AutoFlowMap`
    The same with the structure chosen by the service.

Recordings and maps:

`read_recording`
    The samples of a CSV or Parquet file, valve by valve, a batch at a time.
`fit`
    One valve's map from a recording: a path, a data frame, a dict of arrays.
`replay`
    Recordings through the pipeline of the live service; returns each estimator's map and its fit.
`load_config`, `Config`
    Configurations (TOML) and their schema.
`open_model`, `Model`
    A saved map, or one identified from a recording: predict, invert, interval, compare, plot, save.
`invert`
    The control voltage that passes a flow at a pressure drop, with its interval.
`Samples`
    Aligned samples: U (%), p1, p2 (bar), Q (l/min), T (°C), t (UTC ns).
`ValvemapError`
    Base of all exceptions; the text is one sentence for the user.

Examples
--------
>>> import numpy as np
>>> import valvemap
>>> X = np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]])
>>> found = valvemap.recursive_least_squares(X, X @ [2.0, 3.0])
>>> found.theta.round(9)
array([2., 3.])
"""

from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from valvemap.app.flow_model import Model
    from valvemap.app.models import fit, open_model
    from valvemap.app.replay import replay
    from valvemap.config.loading import load_config
    from valvemap.config.models import Config
    from valvemap.errors import ValvemapError
    from valvemap.model.armax import recursive_maximum_likelihood
    from valvemap.model.inverse_map import invert
    from valvemap.model.least_squares_of_arrays import recursive_least_squares
    from valvemap.model.samples import Samples
    from valvemap.sklearn import AutoFlowMap, FlowMapRegressor
    from valvemap.storage.recordings import read_recording

__all__ = [
    "Config",
    "Model",
    "Samples",
    "ValvemapError",
    "__version__",
    "fit",
    "invert",
    "load_config",
    "open_model",
    "read_recording",
    "recursive_least_squares",
    "recursive_maximum_likelihood",
    "replay",
]

if find_spec("sklearn") is not None:  # help() loads every name
    __all__ += ["AutoFlowMap", "FlowMapRegressor"]

_HOMES = {
    "AutoFlowMap": "valvemap.sklearn",
    "Config": "valvemap.config.models",
    "FlowMapRegressor": "valvemap.sklearn",
    "Model": "valvemap.app.flow_model",
    "Samples": "valvemap.model.samples",
    "ValvemapError": "valvemap.errors",
    "fit": "valvemap.app.models",
    "invert": "valvemap.model.inverse_map",
    "load_config": "valvemap.config.loading",
    "open_model": "valvemap.app.models",
    "read_recording": "valvemap.storage.recordings",
    "recursive_least_squares": "valvemap.model.least_squares_of_arrays",
    "recursive_maximum_likelihood": "valvemap.model.armax",
    "replay": "valvemap.app.replay",
}


def __getattr__(name: str) -> Any:  # noqa: ANN401 - whatever is asked for
    if name == "__version__":
        return version("valvemap")
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'valvemap' has no name {name!r}")
    return getattr(import_module(home), name)


def __dir__() -> list[str]:
    return sorted(__all__)
