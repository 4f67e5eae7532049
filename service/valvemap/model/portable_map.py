"""Maps as values: all that a prediction needs, and nothing that only an update needs.

`to_map` of an estimator extracts one; `restored` makes an estimator and a state of it, which
predict bit-identically. Files of models contain these values.
"""

from typing import Any, assert_never

from valvemap.model.capabilities import Portable
from valvemap.model.estimator import Estimator
from valvemap.model.flow_map import FlowMap
from valvemap.model.linear_map import LinearMap, LinearMapState, LinearParameters
from valvemap.model.portable_flow_map import GaussianMap
from valvemap.model.rbf_network import NetworkMap, RbfNetwork

PortableMap = LinearParameters | NetworkMap | GaussianMap


def to_map(estimator: Estimator[Any], state: Any) -> PortableMap:  # noqa: ANN401 - its own state
    """Return the map of any estimator.

    Raises
    ------
    ValueError
        if the map is not determined yet, or the estimator is not `Portable`.

    Examples
    --------
    >>> import numpy as np
    >>> from valvemap.model.model_structures import FiveTerms
    >>> state = LinearMapState(np.array([0.0, 0.0, 0.0, 0.1, 0.0]), 1e-6 * np.eye(5))
    >>> to_map(LinearMap(FiveTerms()), state).theta
    array([0. , 0. , 0. , 0.1, 0. ])
    """
    match estimator:
        case Portable():
            return estimator.to_map(state)
        case _:
            raise ValueError(f"a {type(estimator).__name__} cannot be saved")


def restored(portable: PortableMap) -> tuple[Estimator[Any], Any]:
    """Return an estimator with this map, and its state."""
    match portable:
        case LinearParameters(structure, theta, covariance):
            return LinearMap(structure), LinearMapState(theta, covariance)
        case NetworkMap(grid, U_range, dp_range, Q_scale):
            network = RbfNetwork(grid=grid, U_range=U_range, dp_range=dp_range, Q_scale=Q_scale)
            return network, portable.state()
        case GaussianMap(U_range, dp_range):
            return FlowMap(U_range, dp_range), portable.state()
        case _:
            assert_never(portable)
