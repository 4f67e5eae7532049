"""Programs of other stacks: started once, told what to do line by line.

Each line that goes in is a JSON object ``{"op": …}``, each line that comes out either
``{"result": …}`` or ``{"error": "…", "code": StatusCode or null}``. What else a program says is
passed over. Clients know the operations connect, disconnect, follow, browse, read, readEvery,
write, call, subscribe, changes and unsubscribe, watchAlarms, alarms and act, and history; ``as``
tells their connections apart. A value travels as ``{type, dimensions, value, code, time}``, time in
ms since 1970; numbers that JSON lacks may be texts such as "NaN".
"""

import asyncio
import json
import tempfile
from typing import Self

ANSWER_S = 60.0


class PeerError(Exception):
    """What a program could not do; ``code`` is the StatusCode, if there is one."""

    def __init__(self, message, code=None):
        super().__init__(message)
        self.code = code


class Peer:
    """One program."""

    def __init__(self, process, errors):
        self._process = process
        self._errors = errors

    @classmethod
    async def start(cls, *command) -> Self:
        errors = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the program
        process = await asyncio.create_subprocess_exec(
            *map(str, command),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=errors,
            limit=2**24,
        )
        return cls(process, errors)

    async def ask(self, op, **fields):
        """Let the program do something and return the result."""
        self._process.stdin.write(json.dumps({"op": op, **fields}).encode() + b"\n")
        async with asyncio.timeout(ANSWER_S):
            while line := await self._process.stdout.readline():
                answer = _answer(line)
                if answer is None:
                    continue
                if "error" in answer:
                    raise PeerError(answer["error"], answer.get("code"))
                return answer["result"]
        self._errors.seek(0)
        said = self._errors.read().decode(errors="replace").splitlines()
        raise PeerError("\n".join([f"the program ended during {op}; it said:", *said[-10:]]))

    async def stop(self):
        """End the program."""
        self._process.stdin.close()
        try:
            async with asyncio.timeout(5.0):
                await self._process.stdout.read()
                await self._process.wait()
        except TimeoutError:
            self._process.kill()
            await self._process.wait()
        self._errors.close()


def _answer(line):
    try:
        found = json.loads(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) and found.keys() & {"result", "error"} else None
