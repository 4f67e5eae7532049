"""The small plant, for tests of the running service."""

from support.small_plant import clock, fresh, identification, plan, sink, source, store  # noqa: F401
