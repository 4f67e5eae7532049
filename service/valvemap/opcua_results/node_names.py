"""Names of valves, estimators and axes: permitted characters, no two alike, none reserved."""

import re
from collections.abc import Sequence

from valvemap.errors import ConfigurationError
from valvemap.opcua_results.information_model import (
    ALARMS,
    BASELINE,
    COMMISSION,
    DEVICE_HEALTH,
    DIAGNOSTICS,
    DYNAMICS,
    FRAME,
    FRAME_NAMES,
    IDENTIFICATION,
    INVERSE,
    NODE_VERSION,
    PROCESS_VALUES,
    RECOMMENDED,
    RECOMMENDED_REASON,
    ROOT,
    SERVICE,
    SIGNALS,
    TYPES,
)
from valvemap.pipeline.results import ValveDescription
from valvemap.vocabulary.edges import PARTS, split_id

_TAKEN = {
    *(DYNAMICS, COMMISSION, INVERSE, DIAGNOSTICS, FRAME, FRAME_NAMES, SIGNALS, ALARMS, BASELINE),
    *(IDENTIFICATION, DEVICE_HEALTH, NODE_VERSION, RECOMMENDED, RECOMMENDED_REASON, PROCESS_VALUES),
    *PARTS,
}
_NAME = re.compile(r"[A-Za-z0-9_-]+")


def check_names(valves: Sequence[ValveDescription]) -> None:
    """Check that names are valid and unique, so that NodeIds and paths keep to the contract.

    Raises
    ------
    ConfigurationError
        if a name is invalid or taken; names the valve or estimator.
    """
    _check_unique("valve", [valve.name for valve in valves], {ROOT, SERVICE, TYPES})
    for valve in valves:
        names = [estimator.name for estimator in valve.estimators]
        _check_unique(f"valve {valve.name}: estimator", names, _TAKEN)


def check_axis_names(axes: Sequence[str]) -> None:
    """Check the names of axes, as `check_names` does those of valves."""
    _check_unique("axis", list(axes), {ROOT, SERVICE, TYPES})


def _own_name(name: str) -> str:
    """Return a name; of an edge or a line, that of its valve."""
    owner, rest = split_id(name)
    return name if rest else owner.partition(".")[0]


def _check_unique(what: str, names: Sequence[str], taken: set[str]) -> None:
    for number, name in enumerate(names):
        if not _NAME.fullmatch(_own_name(name)):
            raise ConfigurationError(
                f"{what} '{name}': a name of letters, digits, '_' and '-' is needed"
            )
        if name in taken or name in names[:number]:
            raise ConfigurationError(f"{what} '{name}': the name is taken")
