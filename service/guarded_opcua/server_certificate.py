"""The server's own certificate and key."""

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import rsa

from guarded_opcua.errors import CertificateError
from guarded_opcua.security.certificates import KEY_BITS, load_certificate
from guarded_opcua.security.own_certificate import ensure_certificate, make_certificate
from guarded_opcua.settings import ServerSettings


def server_certificate(settings: ServerSettings) -> tuple[x509.Certificate, rsa.RSAPrivateKey]:
    """Return the server's certificate and key; both are created if they are missing.

    Raises
    ------
    CertificateError
        if one of them cannot be loaded or created.
    """
    names = settings.host_names or ("localhost", "127.0.0.1")
    uri, name = settings.application_uri, settings.application_name
    if settings.pki is None:  # only encrypts passwords sent to the demo's unsecured endpoint
        key = rsa.generate_private_key(public_exponent=65537, key_size=KEY_BITS)
        return make_certificate(key, uri, names, name), key
    file_name = "".join(c if c.isalnum() else "-" for c in name)
    own = ensure_certificate(settings.pki, uri, names, file_name)
    loaded = serialization.load_pem_private_key(own.key.read_bytes(), None)
    if not isinstance(loaded, rsa.RSAPrivateKey):
        raise CertificateError(f"{own.key}: an RSA key is needed")
    return load_certificate(own.certificate), loaded
