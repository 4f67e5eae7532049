"""All generated reference pages."""

from pathlib import Path

from documentation.address_space import address_space_page
from documentation.alarms import with_alarm_tables
from documentation.commands import commands_page
from documentation.configuration import configuration_page
from documentation.vocabulary import vocabulary_page

ROOT = Path(__file__).parents[1]
REFERENCE = ROOT / "docs" / "reference"
ALARMS = ROOT / "docs" / "alarms.md"
NODE_SET = ROOT / "service" / "valvemap" / "opcua_results" / "valvemap.NodeSet2.xml"
RIG_NODE_SET = ROOT / "virtual_rig" / "valvemap_rig" / "rig.NodeSet2.xml"
MADE_BY = "<!-- Made by `make reference`; do not edit. -->\n\n"


def pages() -> dict[str, str]:
    """Return file name and text of each page."""
    made = {
        "address_space.md": address_space_page(),
        "commands.md": commands_page(),
        "configuration.md": configuration_page(),
        "vocabulary.md": vocabulary_page(),
    }
    return {name: MADE_BY + text for name, text in made.items()}


def alarms_page() -> str:
    """Return the page of alarms, which is written by hand except for its tables."""
    return with_alarm_tables(ALARMS.read_text(encoding="utf-8"))
