# ruff: noqa: INP001 - a script on its own
"""Who may do what on the broker of `docker compose --profile fleet`: ``access.py FLEET.toml``.

The same table is in docs/fleet.md. The user ``topics``, who runs this, may do all.
"""

import sys
from pathlib import Path

from confluent_kafka.admin import (
    AclBinding,
    AclOperation,
    AclPermissionType,
    AdminClient,
    ResourcePatternType,
    ResourceType,
)

from valvemap.kafka.broker import client_settings
from valvemap.kafka.settings import FleetConfig, load_fleet

READ, WRITE = AclOperation.READ, AclOperation.WRITE
LOOK = AclOperation.DESCRIBE_CONFIGS
TOPICS = {  # by user: operations on topics; READ and WRITE imply DESCRIBE
    "collect": {"samples": (WRITE,)},
    "work": {
        "samples": (READ, LOOK),
        "commands": (READ, LOOK),
        "results": (WRITE, LOOK),
        "rejected": (WRITE, LOOK),
        "state": (READ, WRITE, LOOK),
    },
    "serve": {
        "results": (READ,),
        "samples": (READ,),
        "state": (READ,),
        "commands": (WRITE,),
        "rejected": (READ, WRITE),
    },
}
GROUPS = {"work": "work", "serve": "serve."}  # consumer groups, by how their names begin


def main(file: Path) -> None:
    """Allow each user the operations of the tables."""
    config = load_fleet(file)
    admin = AdminClient(client_settings(config.broker))
    made = admin.create_acls(bindings(config), request_timeout=config.broker.timeout_s)
    for done in made.values():
        done.result()


def bindings(config: FleetConfig) -> list[AclBinding]:
    """All of it, as Kafka takes it."""
    prefix = config.topics.prefix
    found = [
        allowed(user, operation, ResourceType.TOPIC, f"{prefix}.{kind}")
        for user, kinds in TOPICS.items()
        for kind, operations in kinds.items()
        for operation in operations
    ]
    begins = ResourcePatternType.PREFIXED
    for user, begin in GROUPS.items():
        found.append(allowed(user, READ, ResourceType.GROUP, f"{prefix}.{begin}", begins))
    for operation in (WRITE, AclOperation.DESCRIBE):
        kind = ResourceType.TRANSACTIONAL_ID
        found.append(allowed("work", operation, kind, f"{prefix}.work", begins))
    return found


def allowed(
    user: str,
    operation: AclOperation,
    kind: ResourceType,
    name: str,
    pattern: ResourcePatternType = ResourcePatternType.LITERAL,
) -> AclBinding:
    """Let a user do one thing from any host."""
    return AclBinding(kind, name, pattern, f"User:{user}", "*", operation, AclPermissionType.ALLOW)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
