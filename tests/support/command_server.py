"""Forks for each order from a process that has imported the modules of ``valvemap`` commands.

    python -P -u tests/support/command_server.py FD

``FD`` is the socket to which `support.command_forks` connects. Linux only: pidfds.
"""

import gc
import json
import os
import resource
import runpy
import select
import signal
import socket
import sys
from contextlib import suppress
from importlib import import_module

IMPORTED = (
    *("valvemap.cli.demo", "valvemap.cli.rig", "valvemap.cli.security", "valvemap.cli.serve"),
    *("valvemap.app.reload", "valvemap.app.service_manager"),
)


def served(door):
    """Fork for every order until all have disconnected; returns the order in the fork."""
    clients, running, ready = {}, {}, select.poll()
    ready.register(door, select.POLLIN)
    while True:
        for fd, _ in ready.poll():
            if fd == door.fileno():
                client, _ = door.accept()
                clients[client.fileno()] = client
                ready.register(client, select.POLLIN)
                client.send(b"1")
            elif fd in running:
                ready.unregister(fd)
                report(fd, *running.pop(fd))
            elif (received := socket.recv_fds(clients[fd], 1 << 20, 4))[0]:
                text, (said, *standard), *_ = received
                if not (pid := os.fork()):
                    for one in (door, *clients.values()):
                        one.detach()
                    become(standard)
                    return json.loads(text)
                ended = begun(pid, said, standard)
                running[ended] = pid, said
                ready.register(ended, select.POLLIN)
            else:
                ready.unregister(fd)
                clients.pop(fd).close()
                if not clients:
                    raise SystemExit


def begun(pid, said, standard):
    """Write the fork's number; returns a descriptor that is ready when the fork ends."""
    os.write(said, f"{pid}\n".encode())
    for one in standard:
        os.close(one)
    return os.pidfd_open(pid)


def report(ended, pid, said):
    """Write exit code and processor seconds of a fork that has ended."""
    _, status, usage = os.wait4(pid, 0)
    found = os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime
    with suppress(BrokenPipeError):  # the worker is gone
        os.write(said, f"{json.dumps(found)}\n".encode())
    os.close(said)
    os.close(ended)


def become(standard):
    """Have the three standard files of the order, and no other."""
    for fd, one in enumerate(standard):
        os.dup2(one, fd)
    os.closerange(3, resource.getrlimit(resource.RLIMIT_NOFILE)[0])


def obey(order):
    """Run the command as ``python -m valvemap`` does, to the end of this process."""
    os.environ.clear()
    os.environ.update(order["environment"])
    os.chdir(order["folder"])
    sys.path.insert(0, order["folder"])
    sys.argv = ["", *order["arguments"]]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    runpy.run_module("valvemap", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the tests, and they this process
    from valvemap.numba_version import ask_for_shortcuts

    ask_for_shortcuts()
    for name in IMPORTED:
        import_module(name)
    gc.freeze()  # a collection would copy every page
    obey(served(socket.socket(fileno=int(sys.argv[1]))))
