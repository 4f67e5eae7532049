"""Workers' metrics over a real Kafka: lag, and each group at the worker that has it."""

import re

import httpx
import pytest

pytest.importorskip("confluent_kafka")

from support.exposition import parsed, promtool_accepts, value
from support.fleet_trial import BLOCKS, GROUPS, Trial
from support.kafka import members, until
from support.processes import wait_for

pytestmark = [pytest.mark.broker, pytest.mark.timeout(600)]


def url_of(trial, n, worker):
    return re.search(r"http://\S+", wait_for(trial.log(n), "metrics served", worker))[0]


def text_of(url):
    answer = httpx.get(url)
    return answer.text if answer.status_code == 200 else ""


def groups(text):
    return {
        dict(labels)["group"] for name, labels in parsed(text) if name == "valvemap_group_block"
    }


def lag(text):
    found = [v for (name, _), v in parsed(text).items() if name == "valvemap_worker_lag_messages"]
    return sum(found) if found else None


def test_groups_are_shown_by_the_worker_that_has_them_and_the_lag_falls_to_zero(broker, tmp_path):
    trial = Trial(tmp_path, broker, "shown")
    with (
        trial.worker(1, "--metrics", "127.0.0.1:0") as first,
        trial.worker(2, "--metrics", "127.0.0.1:0") as second,
    ):
        urls = [url_of(trial, 1, first), url_of(trial, 2, second)]
        until(lambda: members(broker, "shown.work") == 2)
        trial.send(0, BLOCKS // 2)
        trial.until_each_is_behind(BLOCKS // 2 - 4)  # four messages are commands
        until(lambda: [lag(text_of(url)) for url in urls] == [0, 0], 60.0)
        texts = [text_of(url) for url in urls]
        assert not groups(texts[0]) & groups(texts[1])
        assert groups(texts[0]) | groups(texts[1]) == set(GROUPS)
        for text in texts:
            promtool_accepts(text)
            assert value(text, "valvemap_worker_commits_total") > 0
        first.kill()
        trial.send(BLOCKS // 2, BLOCKS + 4)
        trial.until_each_is_behind(BLOCKS)
        until(lambda: groups(text_of(urls[1])) == set(GROUPS), 60.0)
        text = text_of(urls[1])
        assert value(text, "valvemap_group_trouble_total", group="north.0", what="missing") == 0
    assert second.returncode == 0, trial.log(2).read_text()
    trial.check_bits()
