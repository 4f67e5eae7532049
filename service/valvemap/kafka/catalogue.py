"""Catalogue of valves and groups, from the configurations of the services."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from valvemap.app.build import build_plans
from valvemap.config.loading import load_config
from valvemap.config.models import Config
from valvemap.errors import ConfigurationError
from valvemap.kafka.settings import CatalogueConfig
from valvemap.pipeline.valve_state import ValvePlan

NO_SITES: Final = "catalogue.sites: at least one is needed, e.g. { north = 'north.toml' }"


@dataclass(frozen=True)
class GroupPlan:
    """Valves of one group, which share a partition key, and their configuration."""

    name: str
    plans: tuple[ValvePlan, ...]


@dataclass(frozen=True)
class Catalogue:
    """All groups by name, with a version; ``sites`` holds the configurations they are made of."""

    version: int
    groups: Mapping[str, GroupPlan]
    sites: Mapping[str, Config]


def load_catalogue(config: CatalogueConfig) -> Catalogue:
    """Read the configuration of every site.

    Raises
    ------
    ConfigurationError
        if there is no site, or a configuration is invalid.
    """
    if not config.sites:
        raise ConfigurationError(NO_SITES)
    return catalogue_of(
        {site: load_config(file) for site, file in config.sites.items()},
        config.version,
        config.valves_per_group,
    )


def catalogue_of(
    sites: Mapping[str, Config], version: int = 1, valves_per_group: int = 50
) -> Catalogue:
    """Split the valves of each site into groups ``<site>.0``, ``<site>.1`` …, in order.

    Examples
    --------
    >>> list(catalogue_of({"north": Config()}).groups)
    ['north.0']
    """
    groups = {}
    for site, config in sites.items():
        plans = build_plans(config)
        with_ports = next((plan.part.valve for plan in plans if plan.part is not None), None)
        if with_ports is not None:
            raise ConfigurationError(
                f"site {site}: valve {with_ports} has ports; a fleet takes valves with nodes, one "
                "for each edge"
            )
        with_meter = [plan.name for plan in plans if plan.meter]
        if with_meter:
            raise ConfigurationError(
                f"site {site}: valves {', '.join(with_meter)} share a flow meter; a fleet takes "
                "valves with a meter each; `valvemap serve` takes these"
            )
        if config.axes:
            raise ConfigurationError(
                f"site {site}: axis {config.axes[0].name}: a fleet takes valves alone; `valvemap "
                "serve` takes axes"
            )
        for number, first in enumerate(range(0, len(plans), valves_per_group)):
            name = group_name(site, number)
            groups[name] = GroupPlan(name, tuple(plans[first : first + valves_per_group]))
    return Catalogue(version, groups, dict(sites))


def site_of(catalogue: Catalogue, site: str | None) -> str:
    """Return the named site, or the only one.

    Raises
    ------
    ConfigurationError
        if the site does not exist, or no name is given and there are several.
    """
    names = ", ".join(catalogue.sites)
    if site is None and len(catalogue.sites) > 1:
        raise ConfigurationError(f"there are several sites; name one as SITE: {names}")
    if site is not None and site not in catalogue.sites:
        raise ConfigurationError(f"no site {site!r} in the catalogue; there are {names}")
    return site or next(iter(catalogue.sites))


def groups_of(catalogue: Catalogue, site: str) -> list[GroupPlan]:
    """Return the groups of a site, in the order of its valves."""
    own = [g for name, g in catalogue.groups.items() if name.rpartition(".")[0] == site]
    return sorted(own, key=lambda group: int(group.name.rpartition(".")[2]))


def group_name(site: str, number: int) -> str:
    """The name of a site's n-th group."""
    return f"{site}.{number}"
