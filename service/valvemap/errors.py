"""Exceptions of valvemap, whose text is for the user; `guarded_opcua.errors` has the server's.

::

    ValvemapError                 one line for the user, exit code 1
    ├── ConfigurationError        a file, field or argument is wrong, exit code 2
    ├── RecordingError            a recording cannot be read or written
    │   └── NoRecording           no such file, or of unknown format, exit code 2
    ├── StorageError              a store cannot be read or written (disk full, locked, not ours)
    │   ├── NoSuchFile            the named file does not exist, exit code 2
    │   └── StateFileLost         removed or replaced while in use; a new file was made
    ├── FleetError                broker, topics or memory of a fleet cannot be used
    │   ├── BrokerAway            a retry may succeed: no broker can be reached
    │   ├── BlockError            a message is no block that can be read
    │   └── DamagedState          a group's state is damaged; the group can start without it
    ├── CommandRejected           an operator's command cannot be carried out
    ├── SinkError                 the MQTT broker cannot be used
    │   ├── SinkLost              a retry may succeed: connection refused, cut, silent
    │   └── SinkRejected          a retry is useless: it refuses us, or is not trusted
    └── SourceError               the source server
        ├── SourceLost            a retry may succeed: connection refused, cut, silent
        └── SourceRejected        a retry is useless: certificate, user, node, type
"""


class ValvemapError(Exception):
    """A sentence for the user: it names file, field, node or value and the permitted ones."""

    exit_code = 1


class ConfigurationError(ValvemapError):
    """A configuration file, an environment variable or an argument is wrong."""

    exit_code = 2


class RecordingError(ValvemapError):
    """A recording cannot be read or written."""


class NoRecording(RecordingError):  # noqa: N818 - it says what happened
    """The named file does not exist, or its name is not that of a recording."""

    exit_code = 2


class StorageError(ValvemapError):
    """A store cannot be read or written."""


class NoSuchFile(StorageError):  # noqa: N818
    """The named file does not exist."""

    exit_code = 2


class StateFileLost(StorageError):  # noqa: N818
    """The file was removed or replaced; a new one was made, and nothing is saved in it."""


class FleetError(ValvemapError):
    """Broker, topics or memory of a fleet cannot be used."""


class BrokerAway(FleetError):  # noqa: N818 - it says what happened
    """No broker can be reached: pending messages stay in the queue."""


class BlockError(FleetError):
    """A message is no block that can be read."""


class DamagedState(FleetError):  # noqa: N818 - it says what happened
    """A group's state is damaged: it is set aside, and the group starts without it."""


class CommandRejected(ValvemapError):  # noqa: N818 - it says what happened, not what broke
    """An operator's command cannot be carried out; the state is as it was."""


class SinkError(ValvemapError):
    """The MQTT broker cannot be used."""


class SinkLost(SinkError):  # noqa: N818 - it says what happened
    """The connection failed or went silent; a retry may succeed."""


class SinkRejected(SinkError):  # noqa: N818
    """The broker refuses us, or cannot be trusted."""


class SourceError(ValvemapError):
    """The source server cannot be used."""


class SourceLost(SourceError):  # noqa: N818
    """The connection failed or went silent: the supervisor tries again."""


class SourceRejected(SourceError):  # noqa: N818
    """The source answered, and a retry would get the same answer."""


def first_line(error: BaseException) -> str:
    r"""Return the first line of an error's message, or the name of its type if it has none.

    >>> first_line(ValueError("no such valve\nV9")), first_line(TimeoutError())
    ('no such valve', 'TimeoutError')
    """
    return (str(error).splitlines() or [type(error).__name__])[0]
