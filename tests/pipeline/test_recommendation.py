"""The recommendation in words."""

import numpy as np

from valvemap.pipeline.place_ranking import Ranking
from valvemap.pipeline.recommendation import recommendation
from valvemap.pipeline.valve_state import merged_findings
from valvemap.vocabulary.findings import Finding, FindingCode

NAMES = "RLS", "Auto", "RBF"


def test_it_names_the_error_the_next_best_and_how_sure_it_is():
    found = recommendation(Ranking(1, 0.99, np.array([1.7, 0.42, np.inf]), 32), NAMES, "Auto")
    assert found.name == "Auto"
    assert "0.42 l/min" in found.reason
    assert "next RLS 1.7 l/min" in found.reason
    assert "99 % sure" in found.reason


def test_it_says_where_more_visits_help():
    ranking = Ranking(1, 0.99, np.array([1.7, 0.42, np.inf]), 32, 35.0, 120.0)
    found = recommendation(ranking, NAMES, "Auto")
    assert "More visits around U = 35 %, dp = 120 bar" in found.reason


def test_estimators_that_are_alike_are_not_called_worse():
    found = recommendation(Ranking(0, 0.6, np.array([0.41, 0.42, 3.0]), 12), NAMES, "RLS")
    assert "Auto 0.42 l/min is not clearly different" in found.reason
    assert "sure" not in found.reason


def test_none_is_recommended_before_places_were_visited_again():
    found = recommendation(Ranking(-1, 0.0, np.full(3, np.inf), 0), NAMES, "Auto")
    assert found.name == ""
    assert "The inverse is that of Auto" in found.reason


def test_an_inverse_that_is_configured_otherwise_is_said():
    found = recommendation(Ranking(1, 0.99, np.array([1.7, 0.42, 5.0]), 32), NAMES, "RLS")
    assert "configured to be that of RLS" in found.reason


def test_a_cause_that_several_estimators_find_is_named_once_as_the_likelier():
    play, likelier = (Finding(FindingCode.PLAY, p, f"{p}") for p in (0.6, 0.9))
    lag = Finding(FindingCode.LAG_U, 0.7, "lag")
    assert merged_findings([(play,), (likelier, lag), ()]) == (likelier, lag)
