"""Imports UANodeSets, each of which needs those before it, into a server of open62541.

``python companions.py FOLDER FILE...``: like ``imported.py``, of numeric ids. The last line is
JSON: of each namespace the names of the nodes that are found from the root, by their numbers.
"""

import asyncio
import importlib
import json
import sys
from pathlib import Path

_ROOT = "i=84"
_WHOLE = 63  # all fields of a reference


def compiled(files, folder):
    """Have a package made of each file; return their names."""
    compiler = importlib.import_module("o6_nodeset_compiler._dispatch")
    before = ["-e", "ns0"]
    for number, file in enumerate(files):
        name = f"part{number}"
        if compiler.dispatch("python", [file, *before, "--shortname", name, "-o", folder]):
            sys.exit(1)
        before += ["-e", f"{name}@={file}"]
        yield name


async def found(names):
    """Return what a server has that loaded them."""
    import o6

    server = o6.Server(port=0)
    for name in names:
        server.ns.append(importlib.import_module(name))
    server.start()
    await server.waitReady()
    nodes, open_, seen = {}, [_ROOT], {_ROOT}
    while open_:
        for reference in await server.browse(open_.pop(), resultMask=_WHOLE):
            target = reference.nodeId
            if str(target) not in seen:
                seen.add(str(target))
                open_.append(target)
                name = reference.browseName
                shown = nodes.setdefault(target.ns.uri, {})
                shown[str(target.id)] = [name.ns.uri, name.name]
    server.stop()
    return nodes


async def main(out):
    """Do it."""
    folder, *files = sys.argv[1:]
    sys.path.insert(0, folder)
    names = list(compiled([str(Path(file)) for file in files], folder))
    print(json.dumps(await found(names)), file=out, flush=True)


if __name__ == "__main__":
    answers, sys.stdout = sys.stdout, sys.stderr  # both have something to say
    asyncio.run(main(answers))
