import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from valvemap.report.thinning import Thinned


@given(st.lists(st.integers(0, 40), max_size=30), st.integers(1, 20))
def test_the_rows_kept_do_not_depend_on_the_batches(lengths, limit):
    rows = np.arange(sum(lengths))
    whole, cut = Thinned(limit), Thinned(limit)
    whole.add({"t": rows, "theta": np.stack([rows, -rows], axis=1)})
    for part in np.split(rows, np.cumsum(lengths)):
        cut.add({"t": part, "theta": np.stack([part, -part], axis=1)})

    kept = whole.columns["t"]
    assert len(kept) <= limit
    assert len(kept) >= min(len(rows), limit) // 2
    assert cut.columns["t"].tolist() == kept.tolist()
    assert cut.columns["theta"].tolist() == np.stack([kept, -kept], axis=1).tolist()


def test_nothing_seen_is_nothing_kept():
    assert Thinned().columns == {}


def test_what_is_kept_does_not_hold_on_to_the_batches():
    rows = Thinned(limit=10)
    batch = np.zeros(1000)
    rows.add({"t": batch})
    assert rows.columns["t"].base is None
