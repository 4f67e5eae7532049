# ruff: noqa: INP001 - a script on its own
"""Ask the OPC UA server on this machine's port (first argument, else 4841) for a sign of life.

Exit code 0 if it answers Hello with Acknowledge (OPC UA part 6, 7.1.2), else 1 and a line why. An
argument that begins with http:// or https:// is asked for instead: 0 if the answer is a good one.
Its certificate is not checked: it names the host that browsers use, not this one.
"""

import socket
import ssl
import struct
import sys
import urllib.request

TIMEOUT_S = 5.0


def main() -> None:
    """Greet the server once."""
    if len(sys.argv) > 1 and sys.argv[1].startswith(("http://", "https://")):
        ask(sys.argv[1])
        return
    port = int(sys.argv[1]) if len(sys.argv) > 1 else 4841
    try:
        answer = greet(port)
    except OSError as error:
        sys.exit(f"port {port}: {error}")
    if answer[:3] != b"ACK":
        sys.exit(f"port {port}: answered {answer!r} to Hello")


def ask(url: str) -> None:
    """Ask a web server once."""
    try:
        unchecked = ssl._create_unverified_context()  # noqa: S323, SLF001 - as the text above says
        with urllib.request.urlopen(url, timeout=TIMEOUT_S, context=unchecked):  # noqa: S310
            pass
    except OSError as error:
        sys.exit(f"{url}: {error}")


def greet(port: int) -> bytes:
    """Send Hello; return the kind of message that comes back."""
    url = f"opc.tcp://127.0.0.1:{port}/".encode()
    body = struct.pack("<5Ii", 0, 65_535, 65_535, 0, 0, len(url)) + url
    hello = b"HELF" + struct.pack("<I", 8 + len(body)) + body
    with socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT_S) as connection:
        connection.sendall(hello)
        with connection.makefile("rb") as reader:
            return reader.read(4)


if __name__ == "__main__":
    main()
