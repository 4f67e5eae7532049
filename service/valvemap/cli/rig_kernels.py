"""The rig's compiled loops under this command line use the service's kernel cache.

The rig itself does not depend on the service.
"""

from valvemap.model.kernels.compiled import keep_kernels
from valvemap_rig import dynamics, kernels, machine_kernels


def keep_rig_kernels() -> None:
    """Give the rig's loops the service's cache."""
    for module in (dynamics, kernels, machine_kernels):
        keep_kernels(module)
