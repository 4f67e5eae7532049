"""The settings of a plant's server in tests: our own, on loopback, without security."""

from guarded_opcua import ServerSettings


def plant_settings(**more):
    """Return settings with a free port and the namespace urn:plant."""
    return ServerSettings(
        url="opc.tcp://127.0.0.1:0/plant/",
        application_uri="urn:test:plant",
        application_name="plant",
        namespace_uri="urn:plant",
        none_on_loopback=True,
        **more,
    )
