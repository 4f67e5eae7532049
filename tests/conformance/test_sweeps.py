"""What other stacks find at our servers is what the page says, and is without a fault."""

import pytest

from conformance.past import AGGREGATES, disagreement, made
from conformance.stacks import STACKS
from conformance.sweep import SERVERS, sweeps
from documentation.sweeps import PAGE, kept_results, with_sweeps

NEED = {
    "node-opcua": pytest.mark.node,
    "gopcua": pytest.mark.languages,
    "Eclipse Milo": pytest.mark.milo,
    "open62541, in o6": pytest.mark.languages,
}


def test_the_page_has_the_results_of_the_sweeps():
    text = PAGE.read_text(encoding="utf-8")
    assert text == with_sweeps(text, kept_results()), "run `make conformance`"


def test_all_four_stacks_have_swept_and_found_the_same():
    results = kept_results()
    assert list(results) == list(STACKS)
    first, *others = ({k: v for k, v in one.items() if k != "version"} for one in results.values())
    assert all(one == first for one in others)
    for name, stack in STACKS.items():
        assert results[name]["version"] == stack.version()


def test_the_bars_of_the_sweeps():
    """0 faults, 0 dead methods, 0 untyped enumerations, all aggregates right."""
    for found in kept_results().values():
        for server in SERVERS:
            of = found[server]
            assert of["attributes"] == 27 * of["nodes"] > 100_000
            assert (of["faults"], of["failed"], of["dead"], of["untyped"]) == (0, 0, 0, 0)
            assert of["methods"] >= 5
        assert found["service"]["codes"] > 10
        assert found["aggregates"] == {"read": len(AGGREGATES), "wrong": []}


@pytest.mark.parametrize("name", AGGREGATES)
def test_a_wrong_value_time_or_status_of_an_aggregate_is_found(name):
    past = made({False: "good", True: "doubtful"})
    start = past.asked(name)["start"]
    right = [{"value": v, "time": start + t, "code": 0x401} for t, v in past.expected(name)]
    assert disagreement(name, past, {"code": 0, "values": right}) is None
    for k, wrong in ((0, {"value": 1e9}), (3, {"time": start - 1}), (5, {"code": 0x40A40000})):
        values = [dict(one) for one in right]
        values[k] |= wrong
        assert disagreement(name, past, {"code": 0, "values": values})
    assert disagreement(name, past, {"code": 0, "values": right[1:]})


@pytest.mark.timeout(900)  # npm installs, Maven and Go build
@pytest.mark.parametrize("name", [pytest.param(name, marks=NEED[name]) for name in STACKS])
async def test_a_stack_finds_what_the_page_says(name, request, tmp_path):
    program = STACKS[name].program(request.config.cache.mkdir)
    found = await sweeps(program, tmp_path)
    kept = {key: value for key, value in kept_results()[name].items() if key != "version"}
    assert found == kept, "run `make conformance`, and look at what has changed"
