"""The aggregate functions that are supported, and the bits that state how a value was made."""

from enum import IntEnum
from typing import Final

from asyncua import ua

INFO_TYPE: Final = 0x400  # Part 4, 7.39: the bits below belong to a data value
CALCULATED, PARTIAL, MULTI_VALUE = 0x1, 0x4, 0x10


class Aggregate(IntEnum):
    """Supported aggregate functions, by their NodeIds in namespace 0."""

    INTERPOLATIVE = ua.ObjectIds.AggregateFunction_Interpolative
    AVERAGE = ua.ObjectIds.AggregateFunction_Average
    TIME_AVERAGE = ua.ObjectIds.AggregateFunction_TimeAverage
    MINIMUM = ua.ObjectIds.AggregateFunction_Minimum
    MAXIMUM = ua.ObjectIds.AggregateFunction_Maximum
    COUNT = ua.ObjectIds.AggregateFunction_Count
    TOTAL = ua.ObjectIds.AggregateFunction_Total
    MINIMUM_ACTUAL_TIME = ua.ObjectIds.AggregateFunction_MinimumActualTime
    MAXIMUM_ACTUAL_TIME = ua.ObjectIds.AggregateFunction_MaximumActualTime
    RANGE = ua.ObjectIds.AggregateFunction_Range
    START = ua.ObjectIds.AggregateFunction_Start
    END = ua.ObjectIds.AggregateFunction_End
    DELTA = ua.ObjectIds.AggregateFunction_Delta
    STANDARD_DEVIATION_SAMPLE = ua.ObjectIds.AggregateFunction_StandardDeviationSample
    STANDARD_DEVIATION_POPULATION = ua.ObjectIds.AggregateFunction_StandardDeviationPopulation
    VARIANCE_SAMPLE = ua.ObjectIds.AggregateFunction_VarianceSample
    VARIANCE_POPULATION = ua.ObjectIds.AggregateFunction_VariancePopulation
    DURATION_GOOD = ua.ObjectIds.AggregateFunction_DurationGood
    DURATION_BAD = ua.ObjectIds.AggregateFunction_DurationBad
    PERCENT_GOOD = ua.ObjectIds.AggregateFunction_PercentGood
    PERCENT_BAD = ua.ObjectIds.AggregateFunction_PercentBad
