"""Reading a fleet's topics, as anybody may."""

import time

from confluent_kafka import Consumer, KafkaError, KafkaException, TopicPartition
from confluent_kafka.admin import AdminClient

_MOVING = {
    KafkaError.COORDINATOR_LOAD_IN_PROGRESS,
    KafkaError.COORDINATOR_NOT_AVAILABLE,
    KafkaError.NOT_COORDINATOR,
}


def everything(broker, topic):
    """All committed messages of a topic, in the order of each partition."""
    consumer = Consumer(
        {"bootstrap.servers": broker, "group.id": "reader", "enable.auto.commit": False}
    )
    try:
        partitions = consumer.list_topics(topic).topics[topic].partitions
        ends = {p: consumer.get_watermark_offsets(TopicPartition(topic, p))[1] for p in partitions}
        consumer.assign([TopicPartition(topic, p, 0) for p in partitions])
        while True:
            message = consumer.poll(1.0)
            if message is not None and message.error() is None:
                yield message
            places = consumer.position([TopicPartition(topic, p) for p in partitions])
            if all(max(place.offset, 0) >= ends[place.partition] for place in places):
                return
    finally:
        consumer.close()


def until(condition, seconds=240.0):
    """Wait for something, not for ever."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.2)


def members(broker, group):
    """How many consumers of a group have partitions."""
    admin = AdminClient({"bootstrap.servers": broker})
    try:
        found = admin.describe_consumer_groups([group])[group].result().members
    except KafkaException as error:
        if error.args[0].code() in _MOVING:
            return 0  # the group's broker has only just begun, or is another one now
        raise
    return sum(bool(one.assignment.topic_partitions) for one in found)
