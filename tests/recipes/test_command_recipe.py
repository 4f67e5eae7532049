"""The recipe of a command: a row and the method that carries it out, in three files or fewer."""

import json

import pytest

from support.recipes import Tree

TABLE = "service/valvemap/vocabulary/commands.py"
CARRIED_OUT = "service/valvemap/pipeline/estimator_commands.py"

USED = """
import asyncio, json
from asyncua import Client, ua
from guarded_opcua import Role, ServerSettings, UserStore
from valvemap.app.build import build_identification
from valvemap.config.estimators import RlsConfig
from valvemap.config.models import Config
from valvemap.config.valves import ValveConfig
from valvemap.kafka.commands import Command, carry_out, read_command, write_message
from valvemap.opcua_results.results_server import NAMESPACE, ResultsServer

identification = build_identification(
    Config(valves=(ValveConfig(name="V1", estimators=(RlsConfig(),)),))
)
users, password = UserStore.one_time("operator", Role.OPERATOR)
settings = ServerSettings(
    url="opc.tcp://127.0.0.1:0/", application_uri="urn:a", application_name="a",
    namespace_uri=NAMESPACE, users=users, none_on_loopback=True,
)
found = {}


def seen():
    return identification.valves.lane("V1", "RLS").count


async def main():
    async with ResultsServer(settings, identification.descriptions(), identification) as server:
        client = Client(server.url)
        client.set_user("operator")
        client.set_password(password)
        async with client:
            at = await client.get_namespace_index(NAMESPACE)
            owner = client.get_node(ua.NodeId("V1.RLS", at))
            method = ua.NodeId("V1.RLS.Count", at)
            described = await client.get_node(method).read_description()
            found["description"] = described.Text
            await owner.call_method(method, ua.Variant(7.0))
            found["called"] = seen()
            try:
                await owner.call_method(method, ua.Variant(-7.0))
            except ua.UaStatusCodeError as error:
                found["refused"] = type(error).__name__
            action = await client.get_node(ua.NodeId("V1.Diagnostics.LastAction", at)).read_value()
            found["last action"] = action


asyncio.run(main())
message = write_message(Command("1", "north.0", "V1", "count", "RLS", (9.0,)))
carry_out(read_command(message), identification)
found["in a fleet"] = seen()
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    tree = Tree(tmp_path_factory.mktemp("command"))
    tree.after(
        TABLE,
        "ACTIONS: Final = (\n",
        '    Action("count", "Count", Subject.ESTIMATOR, "Set the number of samples.",\n'
        '           inputs=(Input("Samples", "0 < n <= 1e9", 0.0, 1e9),), values=1),\n',
    )
    tree.before(
        CARRIED_OUT,
        "    def freeze(self",
        "    def count(self, valve: str, estimator: str, n: float) -> None:\n"
        '        """Set the number of samples."""\n'
        "        lane = self._valves.lane(valve, estimator)\n"
        "        self._valves.put(valve, estimator, replace(lane, count=int(n)))\n\n",
    )
    return tree


def test_it_takes_three_files_or_fewer(tree):
    assert len(tree.touched) <= 3


def test_clients_and_fleets_can_give_it_and_it_is_recorded(tree):
    found = json.loads(tree.run("-c", USED).splitlines()[-1])
    assert found.pop("last action").endswith("operator: RLS Count 7")
    assert found == {
        "description": "Set the number of samples.",
        "called": 7,
        "refused": "BadOutOfRange",
        "in a fleet": 9,
    }
