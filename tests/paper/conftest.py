"""One set of recordings from the rig, and what was learnt from it."""

import pytest

from paper.evidence import Evidence
from paper.rig import measure
from valvemap.model.rbf_network import RbfNetwork


@pytest.fixture(scope="session")
def paper_data():
    return measure(rate_hz=10.0, seed=1)


@pytest.fixture(scope="session")
def evidence(paper_data):
    return Evidence.of(paper_data, RbfNetwork())
