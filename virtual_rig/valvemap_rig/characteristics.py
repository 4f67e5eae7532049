"""The default valve's characteristic curves as a table: the reference for changes of the physics.

They are stored in ``tests/valvemap_rig/characteristic_curves.csv``. A change of the physics appears
there as a line-by-line diff; to accept it::

    python -m valvemap_rig.characteristics > tests/valvemap_rig/characteristic_curves.csv
"""

import sys
from collections.abc import Iterator

import numpy as np

from valvemap_rig.circuit import Bench, largest_drop, true_flow
from valvemap_rig.valvistor import pilot_opening, poppet_state

HEADER = "U_percent,dp_bar,T_C,Q_l_min,Q_PV_l_min,x_MP_mm,p_c_bar,reachable"

_U = (0, 2.5, 4, 5, 6, 7, 8, 10, 15, 20, 30, 40, 50, 60, 70, 80, 90, 95, 98, 100)
_DP = (0.01, 0.1, 0.5, 1, 2, 5, 10, 20, 50, 80, 100, 150, 195)
_T = (20, 40, 60)


def curves(bench: Bench) -> Iterator[str]:
    """Yield the lines of the table, header first: every U, dp and T, with p1 at supply pressure.

    >>> next(curves(Bench()))
    'U_percent,dp_bar,T_C,Q_l_min,Q_PV_l_min,x_MP_mm,p_c_bar,reachable'
    """
    grid = np.meshgrid(np.array(_U, float), np.array(_DP, float), np.array(_T, float))
    U, dp, T = (axis.transpose(2, 1, 0).ravel() for axis in grid)
    p1 = np.full(U.shape, bench.circuit.p0_bar)
    y = pilot_opening(bench.valve, U)
    state = poppet_state(bench.valve, bench.oil, y, p1, p1 - dp, T, np.ones_like(U))
    inside = dp <= largest_drop(bench, U, T)
    yield HEADER
    columns = (U, dp, T, true_flow(bench, U, dp, T), state.Q_PV, state.x_MP, state.p_c)
    for *values, reached in zip(*columns, inside, strict=True):
        yield ",".join([*(f"{value:.9g}" for value in values), str(int(reached))])


if __name__ == "__main__":
    sys.stdout.writelines(f"{line}\n" for line in curves(Bench()))
