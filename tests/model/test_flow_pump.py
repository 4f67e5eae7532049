"""A pump at its limit holds the flow; a working cycle that passes near a level does not."""

import numpy as np
import pytest

from valvemap.model import flow_causes
from valvemap.model.kernels import flow_path as paths

NOISE = 0.4  # l/min


def visit(limited, seed):
    """U opens from 80 to 92 % while Δp falls, 60 samples: the flow is flat, or has a maximum."""
    u = np.linspace(0.0, 1.0, 60)
    U, flow = 80.0 + 12.0 * u, 100.0 - (0.0 if limited else 4.0) * (2.0 * u - 1.0) ** 2
    rows = np.zeros((60, paths.COLUMNS))
    rows[:, paths.LEFT_U] = U
    rows[:, paths.LEFT_DP] = (flow / U) ** 2 * 60.0
    rows[:, paths.LEFT_Q] = flow + NOISE * np.random.default_rng(seed).standard_normal(60)
    return rows


@pytest.mark.parametrize(("limited", "seed"), [(True, 1), (True, 2), (False, 1), (False, 2)])
def test_a_flow_that_is_held_tells_of_a_pumps_limit_and_one_that_passes_does_not(limited, seed):
    level, evidence = flow_causes.most_delivered(visit(limited, seed), NOISE)
    assert (evidence > 0.0) == limited
    assert level == pytest.approx(100.0, abs=1.5)
