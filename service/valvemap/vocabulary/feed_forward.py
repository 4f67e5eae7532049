"""Status of the feed-forward, published by valve."""

from valvemap.vocabulary.statuses import Described


class FeedForwardStatus(Described):
    """Whether the answer is written to the valve, and if not, why."""

    WRITING = (
        0,
        "writing",
        (
            "RequiredU is written to the valve; U changes no faster than "
            "feed_forward.slew_percent_per_s."
        ),
    )
    NOT_CONFIGURED = 1, "not configured", "nodes.required_U is not configured."
    DISARMED = (
        2,
        "disarmed",
        "Nothing is written: no operator has called Arm since the start or the last Disarm.",
    )
    SOURCE_LOST = 3, "source lost", "There is no connection to the source."
    REFUSED = 4, "refused", "The source refuses the command or the heartbeat."
    STALE = 5, "stale", "The newest sample is older than feed_forward.max_age_s."
    BAD_SAMPLE = 6, "bad sample", "The newest sample is Bad or was rejected."
    NO_DEMAND = 7, "no demand", "Flow, pressure drop or temperature is not known."
    MAP_NOT_GOOD = (
        8,
        "map not good",
        (
            "The map's status is WARMING_UP, HELD, FAILED or UNRELIABLE, or it is not identified "
            "at the demand, or its flow falls there while U rises."
        ),
    )
    EXTRAPOLATED = 9, "extrapolated", "There are no measurements near the demand."
    ABOVE_REACH = (
        10,
        "above reach",
        "The valve cannot pass the demanded flow at this pressure drop.",
    )
    OUT_OF_RANGE = 11, "out of range", "RequiredU is outside feed_forward.range_percent."
    TOO_UNSURE = (
        12,
        "too unsure",
        "The 95 % interval of RequiredU is wider than feed_forward.max_width_percent.",
    )
