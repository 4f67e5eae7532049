"""What goes wrong at a connection, as typed errors with one line each."""

import contextlib
import struct
from collections.abc import Iterator

from asyncua import ua
from asyncua.crypto import uacrypto

from valvemap.errors import SourceLost, SourceRejected
from valvemap.foreign_text import printable
from valvemap.opcua_client.responses import Senseless

_LINE = 300  # characters of a server's wording


@contextlib.contextmanager
def source_errors(url: str, doing: str) -> Iterator[None]:
    """Convert the exceptions of asyncua to SourceLost or SourceRejected."""
    try:
        yield
    except TimeoutError as error:
        raise SourceLost(f"{url}: no answer while {doing}") from error
    except OSError as error:
        reason = error.strerror or str(error) or type(error).__name__
        advice = "; is the server running, and the url right?" if doing == "connecting" else ""
        raise SourceLost(f"{url}: {reason} while {doing}{advice}") from error
    except ua.UaStatusCodeError as error:
        name = status_name(error.code)
        if error.code in _FINAL:
            raise SourceRejected(f"{url}: {name} while {doing}: {_FINAL[error.code]}") from error
        raise SourceLost(f"{url}: {name} while {doing}") from error
    except Senseless as error:
        raise SourceLost(f"{url}: sent {error} while {doing}") from error
    except ua.UaError as error:
        raise SourceLost(f"{url}: {in_one_line(error)} while {doing}") from error
    except uacrypto.InvalidSignature as error:
        raise SourceLost(f"{url}: a wrong signature while {doing}") from error
    except (ValueError, TypeError, LookupError, AttributeError, struct.error) as error:
        reason = in_one_line(error)
        raise SourceLost(f"{url}: an answer that makes no sense while {doing}: {reason}") from error


def in_one_line(text: object) -> str:
    r"""Return a server's text as one line of bounded length.

    >>> in_one_line("No such\npolicy")
    'No such policy'
    """
    said = str(text)[: _LINE + 1]
    return printable("".join(c if c.isprintable() else " " for c in said), _LINE)


def status_name(code: int) -> str:
    """Name of a StatusCode; its number if it has none.

    >>> status_name(0x80340000)
    'BadNodeIdUnknown'
    """
    name, explanation = ua.status_codes.get_name_and_doc(code & 0xFFFF_0000)
    return f"{name} ({code:#010x})" if explanation.startswith("Unknown StatusCode") else str(name)


_REFUSED_CERTIFICATE = "our certificate is refused; the server must trust it"
_FINAL: dict[int, str] = {
    ua.StatusCodes.BadUserAccessDenied: "user or password are wrong, or lack the right",
    ua.StatusCodes.BadIdentityTokenRejected: "user or password are refused; without a user, "
    "the server takes none that is anonymous",
    ua.StatusCodes.BadIdentityTokenInvalid: "this kind of user is not accepted",
    ua.StatusCodes.BadSecurityChecksFailed: _REFUSED_CERTIFICATE,
    ua.StatusCodes.BadSecurityPolicyRejected: "the server does not offer this security",
    ua.StatusCodes.BadSecurityModeRejected: "the server does not offer this security",
    ua.StatusCodes.BadSecurityModeInsufficient: "the server wants more security",
    ua.StatusCodes.BadApplicationSignatureInvalid: _REFUSED_CERTIFICATE,
    ua.StatusCodes.BadUserSignatureInvalid: "the user's certificate is refused",
    ua.StatusCodes.BadCertificateInvalid: _REFUSED_CERTIFICATE,
    ua.StatusCodes.BadCertificateUntrusted: _REFUSED_CERTIFICATE,
    ua.StatusCodes.BadCertificateTimeInvalid: "our certificate has expired",
    ua.StatusCodes.BadCertificateUriInvalid: "our certificate names another application",
    ua.StatusCodes.BadCertificateUseNotAllowed: _REFUSED_CERTIFICATE,
    ua.StatusCodes.BadCertificateRevoked: "our certificate is revoked",
    ua.StatusCodes.BadCertificateChainIncomplete: _REFUSED_CERTIFICATE,
    ua.StatusCodes.BadTcpEndpointUrlInvalid: "the server does not know this URL",
    ua.StatusCodes.BadServiceUnsupported: "the server does not do this",
    ua.StatusCodes.BadMonitoredItemFilterUnsupported: (
        "the server cannot report every sample (trigger StatusValueTimestamp)"
    ),
}
