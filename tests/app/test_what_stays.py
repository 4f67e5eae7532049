"""What another configuration cannot change while the service runs is named by its field."""

from pathlib import Path

import pytest

from valvemap.app.reload import check_what_stays
from valvemap.config.models import Config
from valvemap.config.stores import HistoryConfig, StateConfig
from valvemap.errors import ConfigurationError


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"state": StateConfig(file=Path("other.sqlite"))}, "state.file = 'other.sqlite': cannot"),
        ({"history": HistoryConfig(keep_days=3.0)}, "history.keep_days = '3.0': cannot change"),
        ({"history": HistoryConfig(file=Path("h.sqlite"))}, "history.file = 'h.sqlite': cannot"),
    ],
)
def test_the_field_and_its_new_value_are_named(changed, said):
    with pytest.raises(ConfigurationError, match=said):
        check_what_stays(Config(), Config(**changed))


def test_what_is_the_same_may_stay():
    check_what_stays(Config(), Config(history=HistoryConfig()))
