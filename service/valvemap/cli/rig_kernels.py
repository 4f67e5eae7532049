"""The rig's compiled loops under a command of ours: cached, and shipped, as the service's are.

The rig itself knows nothing of the service.
"""

from valvemap.model.kernels.compiled import keep_kernels
from valvemap_rig import dynamics, kernels


def keep_rig_kernels() -> None:
    """Give them the service's cache."""
    for module in (dynamics, kernels):
        keep_kernels(module)
