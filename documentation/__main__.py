"""Write the reference pages, and the types as UANodeSets: ``python -m documentation``."""

from documentation.node_set import node_set, rig_node_set
from documentation.pages import (
    ALARMS,
    NODE_SET,
    REFERENCE,
    RIG_NODE_SET,
    alarms_page,
    pages,
)


def main() -> None:
    """Write all pages and node sets."""
    for name, text in pages().items():
        (REFERENCE / name).write_text(text, encoding="utf-8")
    ALARMS.write_text(alarms_page(), encoding="utf-8")
    NODE_SET.write_text(node_set(), encoding="utf-8")
    RIG_NODE_SET.write_text(rig_node_set(), encoding="utf-8")


if __name__ == "__main__":
    main()
