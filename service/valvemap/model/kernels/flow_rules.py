"""Every number of `FlowMap` that is chosen rather than estimated: unit; meaning; reason.

They are compiled in: a change of one is a change of every kernel (`kernels.compiled`).
"""

from typing import Final

# The grid.
STEP_U: Final = 1.25  # %; distance of knots along U; a dead band's edge is a bend between two
SHARES_S: Final = (0.0, 0.05, 0.1, 0.18, 0.28, 0.4, 0.55, 0.7, 0.85, 1.0)  # of the largest √|Δp|;
# knots along s: laminar flow bends near 0
MEMORY: Final = 500.0  # samples; what a cell remembers: .05 σ, less than a map needs

# Fits.
FIRST_FIT: Final = 24  # samples; before the first fit: a few more than eq. (7) has parameters
GROWTH: Final = 5  # a fit is due when the samples grew by 1 / GROWTH: bounds the cost of all fits
MOST_BETWEEN: Final = 2048  # samples; between two fits: 20 s at 100 Hz
FIRST_ROUNDS: Final = 8  # rounds of hyper-parameters from the first guess, at most
LATER_ROUNDS: Final = 2  # rounds from those of the last fit, at most
SECOND_START: Final = (
    300  # samples; from which on, at each doubling, hyper-parameters are estimated
)
# from the first guess as well: what was likeliest of few samples may be no more
SETTLED: Final = 0.2  # of its logarithm; a precision that moves less in a round needs no other

# Priors: scales by the flow's root mean square, degrees of freedom of what is estimated.
BEND: Final = 0.01  # of the flow; a bend of U's curve at one knot, before anything is known
CURVE: Final = 0.3  # of the flow; a bend along s from 0 to the largest s
TWIST: Final = 0.01  # of the flow; how a bend of U's curve is bent along s
ZERO_FLOW: Final = 0.02  # of the flow; flow at Δp = 0: an offset of the meter
ANYTHING: Final = 10.0  # of the flow; coefficients, whatever the valve: makes the prior proper
FREEDOM_U: Final = 1.0  # degrees of freedom of bends along U: Cauchy, so that kinks need no shapes
FREEDOM_S: Final = 8.0  # degrees of freedom along s: nearly Gaussian
FREEDOM_LEVEL: Final = 1.0  # degrees of freedom of an axis's level; little, so samples decide
FLAT: Final = 1e3  # times the first guess; precision from which on no bends are left to matter
MISFIT: Final = 0.002  # of the flow; deviation of a cell from the smooth map, before it is known
FREEDOM_MISFIT: Final = 2.0  # degrees of freedom of its prior, which is for none
LEAST_MISFIT: Final = 1e-2  # of the noise; below it a misfit is none
BELOW_KNOTS: Final = 0.08  # of a third difference; standard deviation of what a knee between two
# knots leaves: the best quadratic spline is off by 1/8 of it at the knee itself
NOISE: Final = 0.01  # of the flow; standard deviation of the noise, before it is known
FREEDOM_NOISE: Final = 1.0  # degrees of freedom of that
HASTE: Final = 1.5  # power of a Fellner-Schall step: plain steps fall short of the maximum
MOST_STEP: Final = 30.0  # factor; by which a precision changes in one round at most

# Noise and outliers.
NOISE_MEMORY: Final = 4000.0  # samples; over which variance and correlation are averaged
WAY_U: Final = 15.0  # %; way of U over which a map says the same again
WAY_S: Final = 0.2  # of the largest √|Δp|; the same along s
COLOUR_FROM: Final = 4.0  # samples in a cell from which its error tells of the noise's correlation
MOST_COLOUR: Final = 0.98  # largest correlation of successive errors that is believed
SURE_COLOUR: Final = 3.0  # standard errors from which on a correlation is believed
OUTLIERS: Final = 0.005  # prior share of samples that the meter invents
OUTLIER_WIDTH: Final = 4.0  # root mean squares of the flow; width of their even density

FEW: Final = 4.0  # samples in a cell up to which an outlier may have been among them
DOUBTED: Final = 0.01  # probability below which a cell of few samples began with an outlier
HUGE: Final = 1e9  # of any signal; beyond it squares leave the range of numbers
SURE_CELL: Final = 16.0  # samples in a cell from which on its mean tells the meter's offset
UNKNOWN: Final = 0.5  # of the flow; standard deviation beyond which the map is not known
BEYOND: Final = 0.05  # of the range; how far samples may lie outside and still count at its border

# What moves in time.
MOST_STAY: Final = 4.0  # standard deviations; what a stay in a cell may say against a model at most
LONGEST_STAY: Final = 32  # samples; of which a stay consists at most
OLDEST: Final = 600.0  # s; time that is counted between two stays at most: a machine stood still
RATE_GAIN: Final = 0.15  # 1/h; standard deviation of the gain's rate where it drifts
RATE_EDGE: Final = 4.0  # %/h; standard deviation of the edge's rate
WANDER_GAIN: Final = 0.005  # 1/√h; random walk of the gain beside that
WANDER_EDGE: Final = 0.1  # %/√h; random walk of the edge beside that
PERSISTENCE: Final = 3600.0  # s; how long a rate lasts, about
BETWEEN_DRIFTS: Final = 36_000.0  # s; how long nothing drifts, about
JUMP_GAIN: Final = 0.1  # standard deviation of a sudden change of the gain
JUMP_EDGE: Final = 2.0  # %; standard deviation of a sudden shift of the edge
AFTER_JUMP: Final = 10.0  # s; how long a sudden change is a hypothesis of its own, about
MATURE: Final = 3000  # samples; before them no sudden change is looked for: the map is not sure
BETWEEN_JUMPS: Final = 360_000.0  # s; between two sudden changes, about
VISITED: Final = 1.0  # samples in a cell from which on a stay in it tells what moves
SHARED: Final = 8.0  # samples that have the doubt about gain and edge in common, when they are
# added to their cells
REFUSED: Final = 3.0  # stays in a row; refused as outliers, they are what the cell is now
SHORTEST_STAY: Final = 4  # samples; of which a stay consists that is refused
CERTAIN: Final = 0.95  # probability of a sudden change from which on it is published
OVER: Final = 0.05  # probability of a sudden change below which the last one is over

# Play.
HALF_PLAYS: Final = (0.0, 0.15, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0)  # %; hypotheses
PLAY_GAIN: Final = 300.0  # log likelihood by which another half play is taken: samples of a hold
# have the map's misfit in common
SETTLED_MAP: Final = 150  # samples of a map from which on it tells what moves in time
PLAY_AGAIN: Final = 100.0  # the same where there is some already
PLAY_FROM: Final = 800  # samples of a map from which on it tells of play
PLAY_KEPT: Final = 0.9998  # of what was gained, per sample: 5,000 samples
PLAY_STEP: Final = 0.1  # %; a half play that differs by less needs no new map
PLAY_SURE: Final = 3.0  # standard deviations from which on a correction is made

# Temperature.
THINNING: Final = 0.03  # 1/K; rate of the oil's viscosity, ISO VG 32-68 near 40 °C
WARMTH: Final = 0.1  # of the flow; standard deviation of an effect of viscosity, before it is known
STRONG: Final = 3.0  # times the standard deviation WARMTH; effects where flow is laminar
LAMINAR: Final = 0.1  # of the largest √|Δp|; below it flow is laminar, about
