"""Who the service, its live page and the rig are, and who may log in.

Apart from what is identified: `valvemap rig`, `init` and `trust` need nothing of that.
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
    """Read who may log in.

    Raises
    ------
    ConfigurationError
        if the file is not there: it says what makes it; or if it is wrong.
    """
    if not file.exists():
        raise ConfigurationError(
            f"{file}: no such file; `valvemap init` makes users, certificates and a configuration"
        )
    return UserStore.load(file)
