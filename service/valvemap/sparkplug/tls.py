"""TLS to the broker."""

import ssl

from valvemap.errors import ConfigurationError
from valvemap.sparkplug.settings import BrokerSettings


class _Closing(ssl.SSLSocket):
    """A socket that closes when its handshake fails; paho leaves it to the garbage collector."""

    def do_handshake(self, block: bool = False) -> None:  # noqa: FBT001, FBT002 - as in ssl
        try:
            super().do_handshake(block)
        except BaseException:
            self.close()
            raise


def tls_context(settings: BrokerSettings) -> ssl.SSLContext:
    """Return the context of the settings' certificates.

    Raises
    ------
    ConfigurationError
        if a certificate or key cannot be loaded; names the file.
    """
    for file in (settings.ca_file, settings.certificate_file, settings.key_file):
        if file is not None and not file.is_file():
            raise ConfigurationError(f"{file}: no such file; [mqtt] names it")
    try:
        context = ssl.create_default_context(cafile=settings.ca_file)
        if settings.certificate_file is not None:
            context.load_cert_chain(settings.certificate_file, settings.key_file, password="")
    except (OSError, ValueError) as error:
        names = ", ".join(str(f) for f in (settings.ca_file, settings.certificate_file) if f)
        raise ConfigurationError(f"{names}: cannot be used: {words_of(error)}") from None
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.sslsocket_class = _Closing
    return context


def words_of(error: Exception) -> str:
    """Return the system's reason of an error in lower case, or the error's text."""
    return str(getattr(error, "strerror", None) or error).lower()
