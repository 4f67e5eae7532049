"""The places of valves, and the errors of estimators there, as the kernels' arrays."""

from typing import NamedTuple

from valvemap.model.samples import Floats, Singles, Times

AXES = 3  # U, sign(dp)·√|dp|, T
PLACES_U, PLACES_S, PLACES_T = 12, 8, 2  # most places along each axis
PLACES = PLACES_U * PLACES_S * PLACES_T

# Offsets in a valve's axes, in its sums, in its points, and in an estimator's places and sums.
LOW, HIGH, LOWER, HIGHER, WIDTH = range(5)
OF_AXIS = 5
COUNT, MEAN_Q, VARIANCE_Q, NOW, LEFT, KIND, TAKEN, DUE = range(8)
OF_VALVE = 8
AT_U, AT_DP, AT_T, AT_Q = range(4)
OF_POINT = 4
JUDGED, SQUARE, PAST, STD = range(4)
OF_PLACE = 4
ENTRIES, LOSS, LOSS_MEAN, SKILLED = range(4)
NEWEST, NOISE, NOISE_N, MULTIPLE, COVERED, COVERED_N = range(4, 10)
PAST_SQUARE, PAST_NOISE, EXCESS, TAIL, LOST, SCORE, FIT, CHOSEN = range(10, 18)
OF_LANE = 18

NARROWEST_U, NARROWEST_S, NARROWEST_T = 2.0**-8, 2.0**-8, 1.0  # %, √bar, °C; resolution of sensors
LARGEST = 1e9  # % and √bar; a larger value is no place
MOST_JUDGED = 4096.0  # samples at a place; longest memory of an average over them
WIDEST = 3.0  # times; most that an interval is widened because it held too seldom


class Record(NamedTuple):
    """Places of M valves, and the errors of E estimators there.

    axes : (M, 3, 5)
        Range of U, s and T: the second lowest and highest values, the lowest and highest, and the
        width of a place, a power of two.
    valves : (M, 8)
        Number of usable samples, mean and variance of Q; place of the last sample (-1: none), how
        many more samples of this visit are judged, and whether the place had been visited before;
        number of all samples, and that at which the maps are next evaluated at places left.
    seen : (M, places)
        Number of the newest sample at each place; 0: none.
    points : (M, places, 4)
        U, dp, T and Q of the first sample of each place's newest visit.
    places : (M, E, places, 4)
        Number of judged samples and their mean squared error; error at the place's point, of its
        prediction or of the newest map, and the standard deviation published there.
    lanes : (M, E, 18)
        Number of visits, clipped mean square of map and mean flow, whether the map predicts better;
        residual of the last sample, noise variance from successive residuals and its number;
        multiple of the interval that holds 95 % of new visits, the share within it, and its number;
        mean squared error of the newest maps at all points, the noise in it, and the rest; 95 %
        quantile over the Gaussian one; whether the newest map is worse there than the mean flow;
        the error by which the estimators are ranked, l/min; what the errors say of the map, as an
        `Adaptation`; 0, or of the recommended estimator 1 and the probability that it is better.
    """

    axes: Floats
    valves: Floats
    seen: Times
    points: Singles
    places: Singles
    lanes: Floats


class Scratch(NamedTuple):
    """Room to merge places in: as `Record`'s arrays of one valve."""

    seen: Times
    points: Singles
    places: Singles
