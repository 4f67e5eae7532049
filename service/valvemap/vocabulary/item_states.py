"""The states of a monitored node, from usable to gone."""

from valvemap.vocabulary.statuses import Described


class ItemState(Described):
    """State of one configured node at the source.

    None is final: each is judged again continuously.
    """

    GOOD = 0, "good", "The node is as configured."
    RETYPED = 1, "retyped", "Its numeric type changed; its values are used."
    SLOW = 2, "slow", "The source samples it less often than requested, or than before."
    STILL = 3, "still", "Its value no longer changes, unlike before."
    BAD = 4, "bad", "The source marks its values as Bad."
    WRONG_TYPE = 5, "wrong type", "Its values have no permitted type; they are not used."
    REFUSED = 6, "refused", "This user may not read it."
    GONE = 7, "gone", "The node does not exist."
    SILENT = 8, "silent", "Its value changes at the source, but no change is reported."
