"""Every number of `FlowMap` that is chosen rather than estimated: unit; meaning; reason.

They are compiled in: a change of one is a change of every kernel (`kernels.compiled`).
"""

from typing import Final

# The grid.
STEP_U: Final = 1.25  # %; distance of knots along U; a dead band's edge is a bend between two
SHARES_S: Final = (0.0, 0.05, 0.1, 0.18, 0.28, 0.4, 0.55, 0.7, 0.85, 1.0)  # of the largest √|Δp|;
# knots along s: laminar flow bends near 0

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
SQUARE: Final = 0.05  # of the flow; s·|s| at the largest s: small beside the root's law, which
# decides where Δp goes with U
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
APART: Final = 0.12  # s; samples of one visit to a cell that follow sooner are forgotten together:
# a cell in which a machine rests remembers a minute, longer than a drift goes unnoticed
NOISE_MEMORY: Final = 4000.0  # samples; over which variance and correlation are averaged
WAY_U: Final = 15.0  # %; way of U over which a map says the same again
WAY_S: Final = 0.2  # of the largest √|Δp|; the same along s
COLOUR_FROM: Final = 4.0  # samples in a cell from which its error tells of the noise's correlation
MOST_COLOUR: Final = 0.96  # largest correlation of successive errors that is believed
COLOUR_KNOWN: Final = 100.0  # pairs of successive errors from which on the noise's correlation is
# known: one of .3 is then SURE standard errors; before them it is MOST_COLOUR
METER_LASTS: Final = 0.25  # s; time constant of a meter's noise at most
SURE: Final = 3.0  # standard errors from which on a correlation or a correction of play is believed
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
UNNOTICED: Final = 20.0  # s; for which a drift is learnt by the cells until it is noticed, about
OLDEST: Final = 600.0  # s; time that is counted between two stays at most: a machine stood still
LEVELS: Final = (  # standard deviations: rate, 1/h; random walk beside that, 1/√h; sudden change;
    # what something without a name moves it by
    (0.15, 0.005, 0.3, 0.1),  # gain: a sudden change of 60 % is unusual only
    (4.0, 0.1, 2.0, 2.0),  # edge, %
    (0.1, 0.005, 0.05, 0.0),  # offset of the flow, by its root mean square
    (0.1, 0.005, 0.05, 0.0),  # offset of Δp, by the largest
)
SENSORS_JUMP: Final = 0.01  # of the sudden changes; those that are of one sensor's offset
PERSISTENCE: Final = 3600.0  # s; how long a rate lasts, about
BETWEEN_DRIFTS: Final = 36_000.0  # s; how long nothing drifts, about
LEAST_GAIN: Final = 0.02  # of the flow at first; where less is left, samples tell nothing
BLOCKED_FROM: Final = 0.1  # of the flow; where none of it is shown, meter or valve are blocked
AFTER_JUMP: Final = 10.0  # s; how long a sudden change is a hypothesis of its own, about
WANDERS_WITHIN: Final = 20.0  # s; in which what is not named moves gain and edge that far, about
WEAR_SETTLES: Final = 30.0  # s; after which wear of a part of an edge is estimated again
WEAR_STAYS: Final = 256.0  # stays; after which it is at the latest
WEAR_RECALLED: Final = 900.0  # s; how long ago a part of an edge was as it is, if it does not wear
MOST_SAID: Final = 50.0  # log likelihood that one of these estimates tells at most
MATURE: Final = 3000  # samples; from which on what contradicts a map is hardly its own error
BETWEEN_JUMPS: Final = 360_000.0  # s; between two sudden changes, about
VISITED: Final = 1.0  # samples in a cell from which on a stay in it tells what moves
SHARED: Final = 8.0  # samples that have the doubt about gain and edge in common, when they are
# added to their cells
REFUSED: Final = 3.0  # stays in a row; refused as outliers, they are what the cell is now
SHORTEST_STAY: Final = 4  # samples; of which a stay consists that is refused
STAY_MEMORY: Final = 500.0  # stays; over which their surprise is averaged
FEWEST_STAYS: Final = 100.0  # stays from which on their surprise tells of misfit
SURPRISED: Final = 1.35  # variances; mean square of stays that nothing listed explains; healthy
# valves have .1-1.1, valves with a hidden cause 1.6-2.5
SURPRISE_STEP: Final = 0.05  # variances; scale of its probability about that
OF_CHANGE: Final = 0.1  # of a change's mean square: what the next stay adds to it
CERTAIN: Final = 0.95  # probability of a sudden change from which on it is published
OVER: Final = 0.05  # probability of a sudden change below which the last one is over

# Play.
HALF_PLAYS: Final = (0.0, 0.15, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0)  # %; hypotheses
PLAY_GAIN: Final = 300.0  # log likelihood by which another half play is taken: samples of a hold
# have the map's misfit in common
SETTLED_MAP: Final = 150  # samples of a map from which on it tells what moves in time
SETTLED_FOR: Final = 30.0  # s; age from which on it does: until then drift is less than its error,
# which stays of one oil have in common: of T the first of them tells
PLAY_AGAIN: Final = 100.0  # the same where there is some already
PLAY_FROM: Final = 800  # samples of a map from which on it tells of play
PLAY_KEPT: Final = 0.9998  # of what was gained, per sample: 5,000 samples
PLAY_STEP: Final = 0.1  # %; a half play that differs by less needs no new map

# Temperature.
FLATTENS: Final = 0.3  # cube of ln ν beside its square: oils thin the less the warmer they are
THINNING: Final = 0.03  # 1/K; rate of the oil's viscosity, ISO VG 32-68 near 40 °C
WARMTH: Final = 1.0  # of the flow; standard deviation of an effect of viscosity, before it is known
OTHER_LAW: Final = 0.03  # of the flow between two temperatures; by how much the law is another one
SAME_OIL: Final = 0.15  # of ln ν, 5 K; over which that error is the same
LEAST_WARM: Final = 0.1  # of the flow at first; no oil leaves less of it at another temperature
STRONG: Final = 3.0  # times the standard deviation WARMTH; effects where flow is laminar
LAMINAR: Final = 0.1  # of the largest √|Δp|; below it flow is laminar, about
CREEPING: Final = 0.03  # of the largest √|Δp|; the same for a smaller Reynolds number

# How samples come from the map.
ROWS: Final = 1280  # samples that are kept as measured: 13 s at 100 Hz
LAGS_LEFT: Final = 6.0  # lags after which a first-order lag is over
GAP: Final = 2.5  # s without samples: what lags starts again
ENOUGH_SHOWN: Final = 0.98  # share of what a meter shows now that is known
LONGEST_LAG: Final = 1.5  # s of a stretch that are left out, so that all lags are judged alike
ROBUST_ROUNDS: Final = 6  # fits of a coarse map, without the outliers of the fit before
ROBUST_STEPS: Final = 5  # steps of the robust variance
NOISE_STEPS: Final = (1.0, 0.5, 2.0, 0.25, 4.0)  # factors of σ² that are tried where the places of
# some rows are not known
NEAR_TOP: Final = 0.99  # of the meter's end; beyond it flow is not known
WELL_BELOW_TOP: Final = 0.95  # of the meter's end; a lower reading is a flow, whatever is predicted
NEAR_LEAST: Final = 0.3  # of the least flow; nearer to it either reading is possible
FIRST_WEIGHT: Final = 0.02  # of a sample below the least flow, in the first fit
OFF_ROUNDED: Final = 0.01  # of the least step; further from a multiple no rounded signal is
FADED: Final = 1e-12  # of 1; less of a regressor is rounding, behind a meter's filter
RIDGE: Final = (
    1e-4  # samples' weight that keeps a part of the coarse map without samples determined
)
SHARES_COARSE: Final = (
    0.0,
    0.04,
    0.08,
    0.14,
    0.22,
    0.32,
    0.45,
    0.6,
    0.8,
    1.0,
)  # of U_end; its knots
# Of the slow part of a residual, from row to row, and of an innovation that is slow: of both the
# likeliest are taken. What changes its sign from row to row is a meter's counting of teeth.
SLOW_KEPT: Final = (-0.5, 0.6, 0.8, 0.9, 0.95, 0.98, 1.0)
SLOW_GAINS: Final = (0.0, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0)
PHASES: Final = (0.0, -0.75, -0.5, -0.25, 0.25, 0.5, 0.75)  # slips; where friction may hold a spool
CLEAR: Final = 40.0  # log likelihood from which on an operator is taken
STILL_CLEAR: Final = 10.0  # log likelihood from which on it is kept
MOST_OF_LOOK: Final = 15.0  # log likelihood that one of several looks adds for an operator
LEAST_LAG: Final = 0.25  # of the step between samples; briefer lags are taken by one look only
RIVALS_KEPT: Final = 0.95  # from look to look, of the evidence for operators that are not in use
MOST_OPERATORS: Final = 4  # taken in one look
SHARES_TOP: Final = (0.9, 0.97, 1.0)  # of the readings; where a meter's end is looked for
SEEN_BELOW: Final = 5  # readings of no flow, from which on a meter may have a least flow
POINTS_SHOWN: Final = 16  # parts of equal weight into which what a meter shows is divided
BENT_BY_LAGS: Final = 0.1  # of the flow that a meter's filter adds to that of the mean place: its
# standard deviation, as the map bends on the way
LOOKS: Final = (1024, 2048, 4096)  # samples; after which the last rows are searched for operators
MOST_OF_GUESS: Final = 10.0  # log likelihood that the first sample of a cell tells at most
MOST_BETWEEN_LOOKS: Final = 8192  # samples; between later looks: 82 s at 100 Hz
OTHER: Final = 0.04  # of its value; a parameter that differs by less needs no new map
BOTH_BRANCHES: Final = 0.51  # of the half width of a hysteresis: its standard deviation that makes
# the 95 % interval hold both branches
LEAST_NOISES: Final = 3.0  # standard deviations of the noise; a least flow is larger
MOST_OF_JUMP: Final = 10.0  # log likelihood that one jump over small flows tells at most
REFINEMENTS: Final = 6  # steps of Gauss and Newton over all operators that are there, at most
BEAM: Final = 3  # combinations of operators that are followed at once
DIFFERENCE: Final = 0.02  # of a parameter; half the distance over which derivatives are taken
ABRUPT_STEPS: Final = (1.25, 1.1, 1.04, 1.015, 1.005)  # factors; search along one parameter
MEDIAN_TO_STD: Final = 1.4826  # of a Gaussian
TENTH_TO_STD: Final = 7.958  # standard deviation over the tenth quantile of the size, of a Gaussian
SAME_LEAST: Final = 0.85  # of the least flow seen; a smaller one refutes it
OTHER_HYSTERESIS: Final = (
    2.0  # of the noise's variance; what play leaves if it is another hysteresis
)
KEPT_BY_FILTERS: Final = 0.8  # of what cells hold, at a fit, behind a meter's filter
COARSE: Final = 0.02  # of the flow; standard deviation of the coarse map
OF_COARSE: Final = 0.5  # of the variance that the coarse map leaves: least variance of the noise
STEADY_FILTER: Final = 0.1  # of the noise's variance; doubt about a filter beyond which a sample
# tells nothing of what moves in time
STAY_BEHIND_FILTER: Final = 4.0  # of the noise's variance; least variance of a stay behind a
# filter: the map's errors there are common to many stays
LIKELIER: Final = 1.0  # log likelihood from which on a rival takes an operator's place
EXPLAINED: Final = 1.5  # of the white noise's variance; rows that are left so little need no rivals
MOST_TRIED: Final = 1500  # coarse maps fitted in a look before it tries no more rivals: .5 s
FEWEST_HELD: Final = 15  # values of a signal that is held; from which on its period is known
SHORT_SPANS: Final = 0.1  # of its values are held more briefly than the period: lost ones, jitter
LATEST_VALUE: Final = 1.5  # periods; in which a signal that moves has its next value
HELD_STEPS: Final = 1.5  # steps between samples; a signal that is held longer is published rarely
LONGEST_HELD: Final = 1.0  # s; longer than that a sample does not wait
BESIDE: Final = 8  # samples; on each side of one, of which U's noise is averaged out: to a fourth
APART_MEANS: Final = 2.0  # standard errors; half an interval of such a mean
CALM_STRETCH: Final = 16  # samples; of which U's noise is judged, about a straight line
NO_NOISE: Final = 1e-6  # %; what rounding leaves of a U that rests or moves along a line
CALMEST: Final = 0.1  # of these; where U moves least
OF_CALMEST: Final = 7.79  # variances; such a quantile of χ² of CALM_STRETCH - 2 degrees of freedom
BEFORE_NEWS: Final = 6  # samples, whose straight line says which U was to come
ODDS: Final = 0.01  # of an operator, before anything is known
WORTH_SAYING: Final = 0.5  # probability from which on a finding is given
SAID_FOR: Final = 3600.0  # s; for which a sudden change is a finding
OPEN: Final = (0.5, 0.7, 0.9)  # of U_end; where a compensator is looked for
FAR_APART: Final = (0.2, 0.8)  # of the largest Δp; pressure drops that are compared
HARDLY_RISES: Final = 0.1  # of the flow; less than that from one to the other is a compensator's
PARTLY_BEYOND: Final = 0.85  # of the meter's end; cells of a larger mean may hold flows beyond it
