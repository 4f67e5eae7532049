"""Numbers that are no seconds since 1970 are not taken for them in silence."""

import numpy as np
import pytest

import valvemap

N = 400
SECONDS = 0.02 * np.arange(N)
U = 50.0 + 40.0 * np.sin(SECONDS)
COLUMNS = {
    "U": U,
    "p1": np.full(N, 180.0),
    "p2": 40.0 + 20.0 * np.sin(0.7 * SECONDS),
}
COLUMNS["Q"] = 0.05 * U * np.sqrt(COLUMNS["p1"] - COLUMNS["p2"])
TICKS = (1e7 * SECONDS).astype(np.int64)


@pytest.mark.parametrize(
    ("t", "said"),
    [
        (134_168_400_000_000_000 + TICKS, "100 ns since 1601"),
        (639_079_632_000_000_000 + TICKS, "100 ns since the year 1"),
        (46_082.5 + SECONDS / 86_400, r"t \[d\] for days"),
        (1_772_366_400_000_000 + (1e6 * SECONDS).astype(np.int64), r"t \[us\]"),
    ],
    ids=["FILETIME", "ticks of .NET", "days of a spreadsheet", "microseconds"],
)
def test_times_of_another_unit_or_origin_are_refused(t, said):
    with pytest.raises(valvemap.ValvemapError, match=said):
        valvemap.fit({"t": t, **COLUMNS})


def test_the_remedy_for_days_is_accepted():
    days = {"t": 46_082.5 + SECONDS / 86_400, **COLUMNS}
    model = valvemap.fit(days, units={"t": "d"})
    assert model.predict(50.0, 100.0) == pytest.approx(25.0, rel=0.02)


def test_the_remedy_for_ticks_is_accepted():
    ticks = 134_168_400_000_000_000 + TICKS
    model = valvemap.fit({"t": (ticks - ticks[0]) / 1e7, **COLUMNS})
    assert model.predict(50.0, 100.0) == pytest.approx(25.0, rel=0.02)
