"""o6 (Python over open62541) as a client; see :mod:`support.peer` for what it is told.

A program of its own: importing o6 starts a timer that ends the process after 10 minutes.
"""

import asyncio
import itertools
import json
import sys
from collections import Counter
from datetime import datetime

_URI = "http://opcfoundation.org/UA/SecurityPolicy#"
_TRIGGERS = {"Status": 0, "StatusValue": 1, "StatusValueTimestamp": 2}
_TYPES = {
    "bool": "Boolean",
    "uint8": "Byte",
    "int32": "Int32",
    "uint32": "UInt32",
    "uint64": "UInt64",
    "float32": "Float",
    "float64": "Double",
}
_BROWSED_AT_ONCE = 100
_OBJECT, _METHOD, _DATA_TYPE = 1, 4, 14  # NodeClasses, and an attribute
_EPOCH_TICKS = 116_444_736_000_000_000  # 1970 in units of 100 ns since 1601
_METHODS = {"AddComment": "i=9029", "Acknowledge": "i=9111", "Confirm": "i=9113"}
_ALARM = {
    "event": "EventId",
    "name": "ConditionName",
    "source": "SourceName",
    "text": "Message",
    "active": "ActiveState/Id",
    "acked": "AckedState/Id",
    "confirmed": "ConfirmedState/Id",
    "retain": "Retain",
    "comment": "Comment",
}


class Connection:
    def __init__(self, scope, client):
        self.scope = scope
        self.client = client
        self.subscription = None
        self.changes = []
        self.alarms = {}


class Operations:
    """One method per operation."""

    def __init__(self):
        import o6
        from o6.ns import ns0

        self.o6, self.types = o6, ns0.datatypes
        self.connections = {}
        self.scopes = itertools.count()

    async def connect(self, name, step):
        scope = f"connection{next(self.scopes)}"
        client = self._made(scope, step)
        await client.connect(createDefaultSubscription=False)
        self.connections[name] = Connection(scope, client)
        return {}

    def _made(self, scope, step):
        if "policy" not in step:
            return self.o6.Client(step["url"], name=scope)
        return self.o6.Client(
            step["url"],
            certificate=step["certificate"],
            privateKey=step["key"],
            trustList=[step["server"]],
            securityMode=3,
            securityPolicy=_URI + step["policy"],
            applicationUri=step["applicationUri"],
            username=step["user"],
            password=step["password"],
            name=scope,
        )

    async def disconnect(self, name, _):
        await self.connections.pop(name).client.disconnect()
        return {}

    async def follow(self, name, step):
        path = self.types.BrowsePath()
        path.startingNode = self._id(name, step["node"])
        for uri, browse_name in step["path"]:
            element = self.types.RelativePathElement()
            element.referenceTypeId = self.o6.NodeId("i=33")
            element.includeSubtypes = True
            element.targetName = self.o6.QualifiedName(self._index(name, uri), browse_name)
            path.relativePath.elements = [*path.relativePath.elements, element]
        found = await self._client(name).translateBrowsePathsToNodeIds(path)
        targets = [target.targetId.id for target in found.targets]
        return {"code": int(found.statusCode), "targets": targets}

    async def browse(self, name, step):
        wanted = self.types.BrowseDescription()
        wanted.nodeId = self._id(name, step["node"])
        wanted.referenceTypeId = self.o6.NodeId(step.get("reference", "i=33"))
        wanted.includeSubtypes = True
        wanted.resultMask = 63
        request = self.types.BrowseRequest()
        request.nodesToBrowse = [wanted]
        request.requestedMaxReferencesPerNode = step.get("page", 0)
        (result,) = (await self._client(name).serviceBrowse(request)).results
        names, pages = [], 1
        while True:
            names += [reference.browseName.name for reference in result.references]
            if not bytes(result.continuationPoint):
                return {"code": int(result.statusCode), "names": names, "pages": pages}
            following = self.types.BrowseNextRequest()
            following.continuationPoints = [result.continuationPoint]
            (result,) = (await self._client(name).serviceBrowseNext(following)).results
            pages += 1

    async def walk(self, name, step):
        """All nodes that references lead to, and the methods of objects among them."""
        classes, nodes, methods = {step["root"]: _OBJECT}, [step["root"]], []
        at = 0
        while at < len(nodes):
            batch = nodes[at : at + _BROWSED_AT_ONCE]
            at += len(batch)
            request = self.types.BrowseRequest()
            request.nodesToBrowse = [self._browsed(id_, step["reference"]) for id_ in batch]
            response = await self._client(name).serviceBrowse(request)
            for owner, result in zip(batch, response.results, strict=True):
                if bytes(result.continuationPoint or b""):
                    raise ValueError(f"{owner}: more than a page")
                for found in result.references:
                    id_, kind = str(found.nodeId), int(found.nodeClass)
                    if kind == _METHOD and classes[owner] == _OBJECT:
                        methods.append([owner, id_])
                    if id_ not in classes:
                        classes[id_] = kind
                        nodes.append(id_)
        return {"nodes": nodes, "methods": methods}

    def _browsed(self, id_, reference):
        wanted = self.types.BrowseDescription()
        wanted.nodeId = self.o6.NodeId(id_)
        wanted.referenceTypeId = self.o6.NodeId(reference)
        wanted.includeSubtypes = True
        wanted.resultMask = 63
        return wanted

    async def readEvery(self, name, step):
        """All attributes of each node in a request: how many have which status; the DataTypes."""
        codes, faults, types = Counter(), [], {}
        for id_ in step["nodes"]:
            request = self.types.ReadRequest()
            request.timestampsToReturn = self.types.TimestampsToReturn.BOTH
            wanted = []
            for attribute in step["attributes"]:
                one = self.types.ReadValueId()
                one.nodeId, one.attributeId = self.o6.NodeId(id_), attribute
                wanted.append(one)
            request.nodesToRead = wanted
            try:
                response = await self._client(name).serviceRead(request)
            except self.o6.StatusCodeError as error:
                faults.append(f"{id_}: {error}")
                continue
            for attribute, value in zip(step["attributes"], response.results, strict=True):
                code = int(value.status or 0)
                codes[code] += 1
                if attribute == _DATA_TYPE and code == 0:
                    types[id_] = str(value.value)
        return {"codes": codes, "faults": faults, "types": types}

    async def read(self, name, step):
        value = await self._client(name).read(
            self._id(name, step["node"]),
            attr=step.get("attribute", "Value"),
            range=step.get("range"),
            valueOnly=False,
            timestampsToReturn=self.types.TimestampsToReturn.BOTH,
        )
        return _shown(value)

    async def write(self, name, step):
        value = self._value(step["value"])
        return {"code": int(await self._client(name).write(self._id(name, step["node"]), value))}

    async def call(self, name, step):
        wanted = self.types.CallMethodRequest()
        wanted.objectId = self._id(name, step["owner"])
        wanted.methodId = self._id(name, step["method"])
        wanted.inputArguments = [self._value(value) for value in step["inputs"]]
        request = self.types.CallRequest()
        request.methodsToCall = [wanted]
        (result,) = (await self._client(name).serviceCall(request)).results
        return {
            "code": int(result.statusCode),
            "inputs": [int(code) for code in result.inputArgumentResults],
            "outputs": [_plain(value) for value in result.outputArguments],
        }

    async def subscribe(self, name, step):
        connection = self.connections[name]
        client = connection.client
        connection.subscription = await client.createSubscription(step["interval"], 600, 20, 0)
        connection.changes = [[] for _ in step["items"]]
        items = []
        for number, wanted in enumerate(step["items"]):
            items.append(await self._monitor(name, number, wanted))
        return {"interval": connection.subscription.publishingInterval, "items": items}

    async def changes(self, name, _):
        connection = self.connections[name]
        taken = connection.changes
        connection.changes = [[] for _ in taken]
        return [[_shown(value) for value in item] for item in taken]

    async def unsubscribe(self, name, _):
        await self.connections[name].subscription.delete()
        return {}

    async def watchAlarms(self, name, _):
        connection = self.connections[name]
        client = connection.client
        subscription = await client.createSubscription(50.0, 600, 20, 0)
        filter_ = self.types.EventFilter()
        filter_.selectClauses = [
            self._clause("i=2782", None),
            *(self._clause("i=2041", path) for path in _ALARM.values()),
        ]
        of_type = self.types.ContentFilterElement()
        of_type.filterOperator = self.types.FilterOperator.OF_TYPE
        literal = self.types.LiteralOperand()
        literal.value = self.o6.NodeId("i=2915")  # AlarmConditionType
        of_type.filterOperands = [self.o6.ExtensionObject(literal)]
        filter_.whereClause.elements = [of_type]

        def take(fields):
            condition, *values = fields.values()
            if condition is not None:  # a refresh begins or ends
                connection.alarms[str(condition)] = dict(zip(_ALARM, values, strict=True))

        await client.monitorEvent("i=2253", take, filter_, subscription=subscription)
        number = self.o6.UInt32(subscription.id)
        code, *_ = await client.call("i=2782", "i=3875", [number])  # ConditionRefresh
        code.check()
        return {}

    async def alarms(self, name, _):
        found = self.connections[name].alarms
        return [
            {"condition": id_, **{key: _plain(value) for key, value in alarm.items()}}
            for id_, alarm in found.items()
        ]

    async def act(self, name, step):
        found = self.connections[name].alarms
        ((id_, alarm),) = [
            each for each in found.items() if _plain(each[1]["name"]) == step["name"]
        ]
        given = [alarm["event"], self.o6.LocalizedText(step["comment"], "en")]
        method = _METHODS[step["method"]]
        code, *_ = await self._client(name).call(self.o6.NodeId(id_), method, given)
        return {"code": int(code)}

    async def history(self, name, step):
        start, end = (self.o6.DateTime(step[at] * 10_000 + _EPOCH_TICKS) for at in ("start", "end"))
        if "aggregate" in step:
            details = self.types.ReadProcessedDetails()
            details.processingInterval = step["interval"]
            details.aggregateType = [self.o6.NodeId(step["aggregate"])]
            details.aggregateConfiguration.useServerCapabilitiesDefaults = True
        else:
            details = self.types.ReadRawModifiedDetails()
            details.numValuesPerNode = step.get("page", 0)
        details.startTime, details.endTime = start, end
        wanted = self.types.HistoryReadValueId()
        wanted.nodeId = self._id(name, step["node"])
        request = self.types.HistoryReadRequest()
        request.historyReadDetails = details
        request.timestampsToReturn = self.types.TimestampsToReturn.BOTH
        values, pages = [], 0
        while True:
            request.nodesToRead = [wanted]
            answer = await self._client(name).serviceHistoryRead(request)
            (found,) = answer.results  # these live no longer than the answer
            values += [_shown(value) for value in getattr(found.historyData.body, "dataValues", ())]
            pages += 1
            if not bytes(found.continuationPoint or b""):
                return {"code": int(found.statusCode), "pages": pages, "values": values}
            wanted.continuationPoint = found.continuationPoint

    def _clause(self, kind, path):
        clause = self.types.SimpleAttributeOperand()
        clause.typeDefinitionId = self.o6.NodeId(kind)
        clause.attributeId = 1 if path is None else 13  # NodeId, or Value
        clause.browsePath = [
            self.o6.QualifiedName(0, part) for part in (path or "").split("/") if part
        ]
        return clause

    async def _monitor(self, name, number, wanted):
        connection = self.connections[name]
        filter_ = self.types.DataChangeFilter()
        filter_.trigger = _TRIGGERS[wanted.get("trigger", "StatusValue")]
        deadband = wanted.get("deadband")
        if deadband is not None:
            filter_.deadbandType = {"Absolute": 1, "Percent": 2}[deadband["type"]]
            filter_.deadbandValue = deadband["value"]
        try:
            item = await connection.client.monitor(
                self._id(name, wanted["node"]),
                lambda _, value: connection.changes[number].append(value),
                0.0,
                valueOnly=False,
                subscription=connection.subscription,
                filter=filter_,
                queueSize=wanted.get("queue", 1000),
            )
        except self.o6.StatusCodeError as error:
            return {"code": int(error.code)}
        return {
            "code": 0,
            "queue": int(item.params.queueSize),
            "sampling": item.params.samplingInterval,
        }

    def _client(self, name):
        return self.connections[name].client

    def _id(self, name, text):
        if text.startswith("nsu="):
            uri, _, rest = text.removeprefix("nsu=").partition(";")
            text = f"ns={self._index(name, uri)};{rest}"
        return self.o6.NodeId(text)

    def _index(self, name, uri):
        """The namespaces of each connection have numbers of their own, but for those o6 knows."""
        scope, known = self.connections[name].scope, list(self.o6.ns.filter(uri=uri))
        own = [found.index for found in known if found.scope == scope]
        return [*own, *(found.index for found in known)][0]

    def _value(self, value):
        content = value["value"]
        if value["type"] in ("Float", "Double"):
            content = float(content)
        return getattr(self.o6, value["type"])(content)


def _shown(value):
    time = value.sourceTimestamp
    shape = getattr(value.value, "shape", ())
    moment = None if time is None else datetime.fromisoformat(str(time)).timestamp()
    return {
        "type": _type_of(value.value),
        "dimensions": list(shape) if len(shape) > 1 else None,
        "value": _plain(value.value),
        "code": int(value.status or 0),
        "time": None if moment is None else round(moment * 1e3),
    }


def _type_of(value):
    kind = str(getattr(value, "dtype", "object"))
    if kind != "object":
        return _TYPES[kind]
    return "String" if isinstance(value, str) or hasattr(value, "dtype") else type(value).__name__


def _plain(value):
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if hasattr(value, "tolist"):  # of numpy
        return _plain(value.tolist())
    if isinstance(value, list):
        return [part for item in value for part in _flat(_plain(item))]
    for name in ("text", "name"):
        if hasattr(value, name):
            return getattr(value, name)
    return {name: _plain(getattr(value, name)) for name in dir(value) if name[0] != "_"}


def _flat(item):
    return item if isinstance(item, list) else [item]


async def main(out):
    operations = Operations()
    while line := await asyncio.to_thread(sys.stdin.readline):
        step = json.loads(line)
        operation = getattr(operations, step["op"])
        try:
            answer = {"result": await operation(step.get("as", "main"), step)}
        except operations.o6.StatusCodeError as error:
            answer = {"error": str(error), "code": int(error.code)}
        print(json.dumps(answer), file=out, flush=True)


if __name__ == "__main__":
    answers, sys.stdout = sys.stdout, sys.stderr  # o6 has something to say at its start
    asyncio.run(main(answers))
