"""The series of the fleet's programs, worker and collector, one row a series."""

from collections.abc import Sequence
from typing import Final

from valvemap.vocabulary.series import (
    BROKER_UP,
    BUILD,
    EXPORTER_REFUSED,
    OF_VALVES,
    SOURCE,
    Series,
    counter,
)

WORKER_LAG: Final = Series(
    "valvemap_worker_lag_messages",
    "Messages of a partition that its worker has not received yet.",
    ("topic", "partition"),
)
WORKER_FETCHED: Final = Series(
    "valvemap_worker_fetched_messages",
    "Messages of a partition that the worker's client has fetched and not returned yet.",
    ("topic", "partition"),
)
WORKER_UNSENT: Final = Series(
    "valvemap_worker_unsent_messages", "Results and states that the broker has not taken yet."
)
WORKER_MESSAGES: Final = counter(
    "valvemap_worker_messages", "Messages that the worker has processed.", "kind"
)
WORKER_REJECTED: Final = counter(
    "valvemap_worker_rejected_messages",
    "Messages and states that the worker rejected: each is a dead letter.",
)
WORKER_COMMITS: Final = counter("valvemap_worker_commits", "Commits that the worker has begun.")
WORKER_COMMIT_AGE: Final = Series(
    "valvemap_worker_commit_age_seconds",
    "Time since the worker began a commit; without messages there is none.",
)
WORKER_RESTARTS: Final = counter(
    "valvemap_worker_broker_losses", "Losses of the broker, after which work was repeated."
)
WORKER_UNSHOWN: Final = counter(
    "valvemap_worker_unshown_results", "Results whose metrics could not be computed."
)
GROUP_BLOCK: Final = Series(
    "valvemap_group_block", "Number of the group's newest block of samples.", ("group",)
)
GROUP_TROUBLE: Final = counter(
    "valvemap_group_trouble",
    "Blocks repeated, missing, begun again; messages refused; samples ahead; states damaged.",
    "group",
    "what",
)
GROUP_AGE: Final = Series(
    "valvemap_group_sample_age_seconds",
    "Time between the group's newest published sample and now, by the worker's clock.",
    ("group",),
)

SPOOL_BLOCKS: Final = Series("valvemap_spool_blocks", "Blocks on disk that wait for the broker.")
SPOOL_BYTES: Final = Series("valvemap_spool_bytes", "Size of the blocks that wait for the broker.")
SPOOL_LIMIT: Final = Series(
    "valvemap_spool_limit_bytes", "Size above which the oldest blocks are dropped."
)
COLLECTOR_LOST: Final = counter(
    "valvemap_collector_lost_samples",
    "Samples dropped because the spool or the memory was full, since the spool was created.",
)
COLLECTOR_LEFT_OUT: Final = counter(
    "valvemap_collector_left_out_samples", "Samples of valves whose alignment has failed."
)
COLLECTOR_SAMPLES: Final = counter("valvemap_collector_samples", "Samples packed into blocks.")
COLLECTOR_UNSAVED: Final = Series(
    "valvemap_collector_unsaved_bytes", "Size of the blocks in memory that the disk has not taken."
)
COLLECTOR_VALVES: Final = Series(
    "valvemap_collector_valves", "Valves whose source is connected, or disconnected.", ("state",)
)
COLLECTOR_IN_FLIGHT: Final = Series(
    "valvemap_collector_in_flight_bytes", "Size of the blocks sent and not acknowledged."
)

OF_WORKER: Final[Sequence[Series]] = (
    BUILD,
    *OF_VALVES,
    WORKER_LAG,
    WORKER_FETCHED,
    WORKER_UNSENT,
    WORKER_MESSAGES,
    WORKER_REJECTED,
    WORKER_COMMITS,
    WORKER_COMMIT_AGE,
    WORKER_RESTARTS,
    WORKER_UNSHOWN,
    GROUP_BLOCK,
    GROUP_TROUBLE,
    GROUP_AGE,
    EXPORTER_REFUSED,
)
OF_COLLECTOR: Final[Sequence[Series]] = (
    BUILD,
    SPOOL_BLOCKS,
    SPOOL_BYTES,
    SPOOL_LIMIT,
    COLLECTOR_LOST,
    COLLECTOR_LEFT_OUT,
    COLLECTOR_SAMPLES,
    COLLECTOR_UNSAVED,
    COLLECTOR_VALVES,
    COLLECTOR_IN_FLIGHT,
    BROKER_UP,
    SOURCE,
    EXPORTER_REFUSED,
)
