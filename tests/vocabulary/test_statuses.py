"""The published enumerations: numbered from 0 without gaps, each member with its own words."""

import pytest

from valvemap.page.judgement import INVERSE_SEVERITIES, Reason, Standing, judge
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.findings import FindingCode
from valvemap.vocabulary.statuses import Adaptation, AxisStatus, InverseStatus, Status

PUBLISHED = [AxisStatus, Status, Adaptation, InverseStatus, FeedForwardStatus, FindingCode, Reason]


@pytest.mark.parametrize("statuses", PUBLISHED)
def test_values_count_from_zero_so_that_enum_strings_can_index_them(statuses):
    assert [member.value for member in statuses] == list(range(len(statuses)))


@pytest.mark.parametrize("statuses", PUBLISHED)
def test_each_member_has_a_label_and_a_sentence_of_its_own(statuses):
    assert len({member.label for member in statuses}) == len(statuses)
    assert len({member.sentence for member in statuses}) == len(statuses)
    for member in statuses:
        assert member.label.islower()
        assert member.sentence.endswith(".")


def test_a_member_is_found_by_its_number_alone():
    assert Status(4) is Status.FROZEN
    with pytest.raises(ValueError, match="99"):
        Status(99)


def test_the_page_has_a_severity_for_each_answer_of_the_inverse():
    assert set(INVERSE_SEVERITIES) == set(InverseStatus)


def test_a_status_of_a_newer_service_does_not_stop_the_page():
    assert judge(Standing(code=0, status=99, silent_s=0.1)) is Reason.OK
