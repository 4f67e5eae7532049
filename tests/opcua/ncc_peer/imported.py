"""Imports a UANodeSet into a server of open62541, and says what is there.

``python imported.py FILE URI FLOW FOLDER``: open62541's NodeSet compiler makes a package of the
file in the folder, and o6, which is open62541 for Python, has its server load it. The last line
is JSON: the nodes of the namespace below BaseObjectType and Enumeration, and FLOW's unit.
"""

import asyncio
import importlib
import json
import sys

PACKAGE = "imported_types"
_CLASSES = {1: "Object", 2: "Variable", 4: "Method", 8: "ObjectType", 64: "DataType"}
_ROOTS = ("i=58", "i=29")
_NAMESPACES, _HAS_MODELLING_RULE = "i=2255", "i=37"
_WHOLE = 63  # all fields of a reference


def compiled(file, folder):
    """Have a package made of a UANodeSet."""
    compiler = importlib.import_module("o6_nodeset_compiler._dispatch")
    done = compiler.dispatch("python", [file, "-e", "ns0", "--shortname", PACKAGE, "-o", folder])
    if done:
        sys.exit(done)
    sys.path.insert(0, folder)


async def found(uri, flow):
    """Return what a server has that loaded it."""
    import o6

    server = o6.Server(port=0)
    server.ns.append(importlib.import_module(PACKAGE))
    server.start()
    await server.waitReady()
    assert uri in list(await server.read(_NAMESPACES))
    nodes, open_ = {}, [(root, None) for root in _ROOTS]
    while open_:
        node, parent = open_.pop()
        for reference in await server.browse(node, resultMask=_WHOLE):
            target = reference.nodeId
            if target.ns.uri != uri or target.id in nodes or not isinstance(target.id, str):
                continue  # a number: open62541 gave an instance what its type demands
            rules = await server.browse(target, reftype=_HAS_MODELLING_RULE, resultMask=_WHOLE)
            nodes[target.id] = {
                "id": target.id,
                "name": reference.browseName.name,
                "class": _CLASSES[int(reference.nodeClass)],
                "type": str(reference.typeDefinition),
                "rule": rules[0].browseName.name if rules else None,
                "parent": parent,
            }
            open_.append((target, target.id))
    unit = await server.read(f"ns={PACKAGE};s={flow}.EngineeringUnits")
    server.stop()
    return {"nodes": list(nodes.values()), "unit": unit.displayName.text}


async def main(out):
    """Do it."""
    file, uri, flow, folder = sys.argv[1:]
    compiled(file, folder)
    print(json.dumps(await found(uri, flow)), file=out, flush=True)


if __name__ == "__main__":
    answers, sys.stdout = sys.stdout, sys.stderr  # both have something to say
    asyncio.run(main(answers))
