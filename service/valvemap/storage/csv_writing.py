"""Recordings as lines of CSV."""

import csv
import io

from valvemap.model.samples import Samples
from valvemap.storage import columns
from valvemap.storage.layout import COLUMNS
from valvemap.vocabulary.signals import MEASURED


def csv_rows(valve: str, samples: Samples) -> bytes:
    r"""Return samples as CSV lines that read back bit-identically.

    >>> csv_rows("V1", Samples.of(t=[10**15], U=[0.1], p1=[200], p2=[1e-9], Q=[30]))
    b'1000000000000000,0.1,200.0,1e-09,30.0,nan,V1,0\n'
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(
        zip(
            map(columns.time_text, samples.t.tolist()),
            *(getattr(samples, name).tolist() for name in MEASURED),
            (valve,) * len(samples),
            samples.quality.tolist(),
            strict=True,
        )
    )
    return text.getvalue().encode()


def csv_header() -> bytes:
    """Return the header line for :func:`csv_rows`."""
    return (",".join(COLUMNS) + "\n").encode()
