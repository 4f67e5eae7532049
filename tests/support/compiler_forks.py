"""Python code in forks of a process that has imported numba and compiled once, which takes 0.8 s.

A fork has imported nothing of valvemap: it reads cached kernels and stamps as a new process does.
"""

import json
import os
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import dataclass

_SERVE = """
import json, os, sys, tempfile, traceback
import numba, numpy
numba.njit(lambda x: x + 1.0)(1.0)

def run(order):
    os.environ.clear()
    os.environ.update(order["environment"])
    numba.core.config.reload_config()
    sys.dont_write_bytecode = bool(os.environ.get("PYTHONDONTWRITEBYTECODE"))
    sys.path[:0] = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    sys.argv = ["-c", *order["arguments"]]
    exec(compile(order["code"], "<string>", "exec"), {"__name__": "__main__"})

for line in sys.stdin:
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        child = os.fork()
        if not child:
            os.dup2(out.fileno(), 1)
            os.dup2(err.fileno(), 2)
            code = 0
            try:
                run(json.loads(line))
            except BaseException:
                code = 1
                traceback.print_exc()
            sys.stdout.flush()
            os._exit(code)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        said = [os.pread(one.fileno(), 1 << 20, 0).decode() for one in (out, err)]
    print(json.dumps([code, *said]), flush=True)
"""


@dataclass(frozen=True)
class Forks:
    """The process that forks."""

    process: subprocess.Popen[str]

    def run(self, code, environment, *arguments):
        """Run code in a fork; the answer has returncode, stdout and stderr."""
        order = {"code": code, "environment": environment, "arguments": arguments}
        print(json.dumps(order), file=self.process.stdin, flush=True)
        returncode, out, err = json.loads(self.process.stdout.readline())
        return subprocess.CompletedProcess([], returncode, out, err)


@contextmanager
def forks(**environment):
    """A process that waits for code to run; numba's settings are fixed by its environment."""
    with subprocess.Popen(
        [sys.executable, "-c", _SERVE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=without_numba() | environment,
    ) as process:
        yield Forks(process)
        process.stdin.close()


def without_numba():
    """The environment of this process, but for settings of numba."""
    return {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
