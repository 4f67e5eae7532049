"""`valvemap warm-up` compiles what the demo's rig needs, too."""

from valvemap.cli.rig_kernels import compile_rig_kernels
from valvemap_rig import dynamics, kernels, machine_kernels
from valvemap_rig.scenario import BUILTIN
from valvemap_rig.simulation import advance, initial
from valvemap_rig.verification import verification_points


def compiled():
    """The types of arguments that each loop of the rig was compiled for."""
    loops = (
        loop
        for module in (dynamics, kernels, machine_kernels)
        for loop in vars(module).values()
        if hasattr(loop, "signatures")
    )
    return {loop.__name__: set(loop.signatures) for loop in loops}


def test_nothing_is_left_to_compile_when_valves_play():
    compile_rig_kernels()
    before = compiled()
    assert any(before.values())
    for scenario in (one for one in BUILTIN.values() if not one.machines):
        state = initial(scenario, 0)
        for n in (1, 10):
            state, _ = advance(scenario, state, n)
        verification_points(scenario)
    assert compiled() == before
