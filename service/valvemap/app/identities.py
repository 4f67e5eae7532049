"""The application identities of service, live page and rig, and the user store.

Separate from the identification, because `valvemap rig`, `init` and `trust` do not import it.
"""

from importlib.metadata import version
from pathlib import Path

from guarded_opcua import Product, UserStore
from valvemap.errors import ConfigurationError
from valvemap.opcua_results.namespaces import RIG_NAMESPACE, SERVICE_NAMESPACE

APPLICATION_URI = SERVICE_NAMESPACE
APPLICATION_NAME = "valvemap service"
PRODUCT = Product("urn:valvemap", "valvemap", version("valvemap"))

PAGE_URI = "urn:valvemap:dashboard"
PAGE_NAME = "valvemap dashboard"
PAGE_USER = "dashboard"

RIG_URI = RIG_NAMESPACE
RIG_NAME = "valvemap rig"


def load_users(file: Path) -> UserStore:
    """Load the users who may log in.

    Raises
    ------
    ConfigurationError
        if the file is missing (names the command that creates it) or invalid.
    """
    if not file.exists():
        raise ConfigurationError(
            f"{file}: no such file; `valvemap init` makes users, certificates and a configuration"
        )
    return UserStore.load(file)
