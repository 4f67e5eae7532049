"""All exceptions with a message for the user.

::

    HardenedError                 one line for the user
    ├── ConfigurationError        a setting, file or argument is wrong
    ├── StorageError              a file cannot be written
    ├── CertificateError          a certificate or key is missing, expired or not trusted
    ├── ServerError               the server cannot run (port in use, address not local)
    └── CommandRejected           a client's command cannot be executed
"""


class HardenedError(Exception):
    """A message for the user with the file, field, node or value and the allowed values."""


class ConfigurationError(HardenedError):
    """A setting, a file of settings or an argument is wrong."""


class StorageError(HardenedError):
    """A file cannot be written."""


class CertificateError(HardenedError):
    """A certificate or key is missing, expired or not trusted."""


class ServerError(HardenedError):
    """The server cannot run."""


class CommandRejected(HardenedError):  # noqa: N818 - named after the event, not the fault
    """A write or a call was rejected; nothing has changed."""
