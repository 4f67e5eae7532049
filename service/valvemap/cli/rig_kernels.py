"""The rig's compiled loops under this command line use the service's kernel cache.

The rig itself does not depend on the service.
"""

from valvemap.model.kernels.compiled import keep_kernels
from valvemap_rig import dynamics, kernels, machine_kernels
from valvemap_rig.scenario import load_scenario
from valvemap_rig.simulation import advance, initial
from valvemap_rig.verification import verification_points


def keep_rig_kernels() -> None:
    """Give the rig's loops the service's cache."""
    for module in (dynamics, kernels, machine_kernels):
        keep_kernels(module)


def compile_rig_kernels() -> None:
    """Compile the loops of the rig's valves and of their true map, or load them.

    Those of machines would add a tenth to a wheel's kernels.
    """
    keep_rig_kernels()
    demo = load_scenario("demo")
    advance(demo, initial(demo, 0), 1)
    verification_points(demo)
