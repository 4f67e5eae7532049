"""The clock of each valve's samples against a time that never jumps. Pure.

Two clocks of a source are known: its CurrentTime, read now and then, and the times of its samples.
Their offsets against our monotonic time t_m are o_r and o_s. A sample of time t is late by
L = t_m + o_r - t when it arrives. If either clock is set, L jumps though nothing was delayed. Such
a step is certain when samples run backwards, when they come from the future, or when o_r itself
jumps. The correction S keeps the lateness L + S over every step, so ages are t_m + o_r + S - t.
Once both clocks have made the same step, S is 0 again.
"""

from typing import Final

import numpy as np

from valvemap.model.samples import Floats, Times

STEP_S: Final = 1.5  # s; less may be the uncertainty of a reading: CurrentTime has steps of 1 s
_LATE_S: Final = 1.0  # s; largest lateness that is assumed after a step
_FUTURE_S: Final = 10.0  # s; a smaller lead may be a busy source's late CurrentTime
_SILENT_S: Final = 5.0  # s; after a longer silence a sample may be as late as that
_NO_SAMPLE: Final = 0


class SampleClocks:
    """Correction of V valves' ages for steps of clocks.

    Parameters
    ----------
    valves
        Number of valves, V.

    Attributes
    ----------
    correction_s : float64
        S of each valve, (V,), s.
    changes : int
        How often it was written.

    Examples
    --------
    A source is set back by an hour; its CurrentTime, read later, follows.

    >>> clocks, one = SampleClocks(1), np.array([0])
    >>> clocks.note(one, np.array([100_000_000_000]), now_s=0.0, offset_s=np.array([100.0]))
    >>> clocks.note(one, np.array([-3_499_000_000_000]), now_s=1.0, offset_s=np.array([100.0]))
    >>> clocks.correction_s
    array([-3600.])
    >>> clocks.note_offset(np.array([-3500.0]))
    >>> clocks.correction_s
    array([0.])
    """

    def __init__(self, valves: int) -> None:
        self.correction_s = np.zeros(valves)
        self.changes = 0
        self._offset_s = np.full(valves, np.nan)
        self._newest = np.zeros(valves, np.int64)
        self._late_s = np.zeros(valves)  # L + S at the last arrival
        self._heard_s = np.zeros(valves)

    def note_offset(self, offset_s: Floats) -> None:
        """Note o_r, (V,), s: a jump of it alone ages no sample."""
        jump = offset_s - self._offset_s  # NaN at first
        jumped = np.abs(jump) > STEP_S
        if np.count_nonzero(jumped):  # quicker than `any` for few valves
            self.changes += 1
            self.correction_s[jumped] = _small_is_0(self.correction_s - jump)[jumped]
        self._offset_s = np.array(offset_s, np.float64)

    def note(self, valves: Times, newest: Times, now_s: float, offset_s: Floats) -> None:
        """Note the times (M,), UTC ns, of the newest samples of these valves (M,), just arrived.

        ``now_s`` is our monotonic time, ``offset_s`` (V,) is o_r.
        """
        self.note_offset(offset_s)
        before = self._newest[valves]
        late = now_s + self._offset_s[valves] - newest * 1e-9
        corrected = late + self.correction_s[valves]
        set_back = (before != _NO_SAMPLE) & (newest < before)
        stepped = set_back | (corrected < -_FUTURE_S)
        silent = now_s - self._heard_s[valves]
        kept = np.clip(self._late_s[valves], 0.0, _LATE_S)
        latest = np.maximum(self._late_s[valves], 0.0) + silent  # taken after the one before
        delayed = (late >= -STEP_S) & (late <= latest + STEP_S)  # no step is needed for it
        assumed = kept + np.where(silent > _SILENT_S, silent, 0.0)
        restored = np.where(delayed, 0.0, _small_is_0(assumed - late))
        joined = (late >= -STEP_S) & (late <= kept + STEP_S)  # both clocks have made the step
        correction = np.where(stepped, restored, np.where(joined, 0.0, self.correction_s[valves]))
        self._heard_s[valves] = now_s
        self.correction_s[valves] = correction
        self.changes += 1
        self._late_s[valves] = late + correction
        self._newest[valves] = newest

    def forget(self, valves: Times) -> None:
        """Drop the steps of these valves: their source was restarted, and its clock read again."""
        self.correction_s[valves] = 0.0
        self.changes += 1
        self._newest[valves] = _NO_SAMPLE


def _small_is_0(correction: Floats) -> Floats:
    return np.where(np.abs(correction) > STEP_S, correction, 0.0)
