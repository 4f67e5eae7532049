"""The memory of places as arrays, and the limits that its kernels share."""

from typing import NamedTuple

from valvemap.model.samples import Codes, Floats, Singles

# Fields of a node in `places`: effective samples of its flow; clock time of the last touch; mean
# square of d around it; mean of d over the last visit; end of that visit.
KNOWN, TOUCHED, SPREAD, DEVIATION, VISITED = range(5)
FIELDS = 5
# In `visits`: number since the plant changed, up to MANY; looks of the last visit.
VISITS, STAYED = range(2)
FIELDS_OF_VISITS = 2
MANY = 255

NODES_A, NODES_B = 17, 12  # of the grid, along U and √dp
TOP_DP = 225.0  # bar: the last node

LEAST = 0.02  # samples of a node below which it counts as new
CLIP = 4.0  # standard deviations at which d is clipped: outliers
APART = 64.0  # samples; noise is uncorrelated beyond: a longer stay counts as another visit,
# and visits closer together as one
LAG_MEMORY = 3000.0  # samples in visits; memory of the lag
PROVEN = 2.0  # logarithm of the speed-up of forgetting from which drift is proven
MOST = 1e30  # l/min, or its square: larger than any flow, within single precision


class Remembered(NamedTuple):
    """Memory of K nodes of one state.

    flows : (K,)
        l/min.
    places : (K, FIELDS), visits : (K, FIELDS_OF_VISITS)
        The fields above.
    """

    flows: Floats
    places: Singles
    visits: Codes
