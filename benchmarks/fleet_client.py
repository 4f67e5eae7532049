"""A bare client that learns as a worker does: ``python -m benchmarks.fleet_client FLEET.toml``.

confluent-kafka alone: states, results and offsets in one transaction; memories go to the
results' topic under separate keys, once in a transaction. It takes nothing over.
"""

import signal
import sys
import time
from pathlib import Path

from confluent_kafka import Consumer, Producer

from valvemap.app.warm_up import warm_up
from valvemap.kafka.blocks import read_samples
from valvemap.kafka.catalogue import load_catalogue
from valvemap.kafka.group import Group, Rhythm
from valvemap.kafka.result_blocks import write_results
from valvemap.kafka.settings import load_fleet


def main(arguments: list[str]) -> int:
    """Learn until SIGTERM."""
    config = load_fleet(Path(arguments[0]))
    catalogue, prefix = load_catalogue(config.catalogue), config.topics.prefix
    for site in catalogue.sites.values():
        warm_up(site)
    groups: dict[str, Group] = {}
    servers = {"bootstrap.servers": ",".join(config.broker.addresses)}
    consumer = Consumer(
        {
            **servers,
            "group.id": f"{prefix}.bare",
            "auto.offset.reset": "earliest",
            "enable.auto.commit": False,
        }
    )
    producer = Producer(
        {
            **servers,
            "transactional.id": f"{prefix}.bare",
            "message.max.bytes": 16_000_000,
            "compression.type": "none",
            "linger.ms": 5,
        }
    )
    producer.init_transactions()
    consumer.subscribe([f"{prefix}.samples"])
    running = True

    def stop(*_: object) -> None:
        nonlocal running
        running = False

    signal.signal(signal.SIGTERM, stop)
    rhythm = Rhythm(round(config.work.results_s * 1e9), round(config.work.maps_s * 1e9))
    while running:
        end, touched = time.monotonic() + config.work.commit_s, set()
        producer.begin_transaction()
        while time.monotonic() < end:
            for message in consumer.consume(10, 0.02):
                block = read_samples(message.value())
                plan = catalogue.groups[block.group]
                group = groups.setdefault(block.group, Group(plan, catalogue.version, rhythm))
                for results in group.take(block):
                    producer.produce(f"{prefix}.results", write_results(results), message.key())
                touched.add(block.group)
        for name in touched:
            producer.produce(
                f"{prefix}.results", groups[name].to_bytes(), b"memory " + name.encode()
            )
        offsets = [place for place in consumer.position(consumer.assignment()) if place.offset >= 0]
        producer.send_offsets_to_transaction(offsets, consumer.consumer_group_metadata())
        producer.commit_transaction()
    consumer.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
