"""The approved map of a valve, from the state file of its service."""

from dataclasses import dataclass

import numpy as np

from valvemap.app.build import build_identification
from valvemap.config.loading import config_of
from valvemap.config.models import Config
from valvemap.errors import CommandRejected, ConfigurationError
from valvemap.model.samples import Floats
from valvemap.pipeline.identification import Identification
from valvemap.storage.state_files import read_states


@dataclass(frozen=True)
class ApprovedMap:
    """The approved map of one valve; ``name`` is its version and estimator."""

    name: str
    _valve: str
    _estimator: str
    _known: Identification

    def predict(self, U: Floats, dp: float) -> Floats:
        """Flow (N,) at U (N,), %, and one pressure drop, bar; NaN where it is not known."""
        ask = self._known.predict_approved
        return np.array(
            [ask(self._valve, self._estimator, u, dp, np.nan)[0] for u in U.tolist()], np.float64
        )


def approved_map(config: Config, valve: str) -> ApprovedMap:
    """Return the map that an operator approved, of the estimator whose map is inverted.

    The service may be running: the file has its newest checkpoint.

    Raises
    ------
    ConfigurationError
        if the valve has no approved map, or it was made with other settings.
    StorageError
        if the state file cannot be read.
    """
    own = config_of(config, valve)
    identification = build_identification(own)
    stored, _ = read_states(config.state.file)
    reviewed = identification.states.review([one for one in stored if one.valve == valve])
    identification.restore(reviewed.checkpoints)
    baseline = identification.baseline(0)
    if baseline is None:
        raise ConfigurationError(
            f"--approved: {config.state.file} holds no approved map of valve {valve}; "
            "approve one with `valvemap baseline approve`, or compare with a file by --against"
        )
    estimator = identification.plans[0].inverse
    try:
        identification.predict_approved(valve, estimator, 50.0, 50.0, np.nan)
    except CommandRejected as error:
        raise ConfigurationError(f"--approved: {error}") from None
    name = f"the approved map {baseline.version} ({estimator})"
    return ApprovedMap(name, valve, estimator, identification)
