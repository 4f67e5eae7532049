"""Every decoder of foreign bytes: valid inputs and announced exceptions."""

import gzip
import json
import sqlite3
import struct
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import partial
from itertools import count

import numpy as np
from asyncua import ua
from asyncua.ua import ua_binary
from cryptography.hazmat.primitives import serialization
from paho.mqtt.client import MQTTv311
from paho.mqtt.enums import CallbackAPIVersion

from guarded_opcua import Role
from guarded_opcua import errors as hardened
from guarded_opcua.binary.bounded_decoding import Budget, Reader, decode
from guarded_opcua.binary.index_range import IndexRangeError, parse_index_range
from guarded_opcua.security.certificate_rules import CertificateRefused, parse
from guarded_opcua.security.certificates import load_certificate
from guarded_opcua.security.pki_folders import Pki
from guarded_opcua.security.trust_folders import TrustFolders
from guarded_opcua.security.users import UserStore
from support import certificates
from support.fleet import block, catalogue, feed, group
from support.mutations import requests
from support.plant import START, as_changes, plant
from valvemap.config.estimators import RlsConfig
from valvemap.config.loading import load_config
from valvemap.errors import (
    BlockError,
    ConfigurationError,
    FleetError,
    RecordingError,
    SourceRejected,
    StorageError,
)
from valvemap.kafka.blocks import SamplesBlock, read_samples, write_samples
from valvemap.kafka.client_statistics import read_statistics
from valvemap.kafka.commands import Command, Reply, read_command, read_reply, write_message
from valvemap.kafka.memory import Columns, Memory, read_memory, sealed, write_memory
from valvemap.kafka.result_blocks import ResultsBlock, read_results, write_results
from valvemap.model.axis import AxisGeometry, AxisRegression
from valvemap.model.axis_basis import SIZE
from valvemap.model.axis_condition import Condition, Reference
from valvemap.model.axis_force import ForceState
from valvemap.model.estimator import State, StateMismatchError
from valvemap.model.flow_map import FlowMap
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Segments
from valvemap.opcua_client import responses
from valvemap.opcua_source import decoding
from valvemap.opcua_source.members import Member, encodings_of, taken
from valvemap.opcua_source.node_ids import parse_node_id
from valvemap.opcua_source.position import position_from_bytes
from valvemap.opcua_source.structures import Field, Form, Structure, kind_of
from valvemap.opcua_source.wire import DecodeError
from valvemap.page.answering import request_of
from valvemap.page.questions import Senseless as SenselessRequest
from valvemap.pipeline import kept_axes, operator_ports
from valvemap.pipeline.alarm_results import AlarmReport
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_alarms import AxisAlarms
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.axis_searches import Searches
from valvemap.pipeline.axis_watch import AxisWatch, AxisWindowSums
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.dynamics_reference import DynamicsReference
from valvemap.pipeline.edges import gathered
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.kept_axes import ALARMS, SEARCHES, WATCH
from valvemap.pipeline.kept_watches import pack_watch
from valvemap.pipeline.meters import Meters
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.timing import Timing
from valvemap.pipeline.timing_state import TimingSettings
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.sparkplug.commands import Commands
from valvemap.sparkplug.edge_node import Message
from valvemap.sparkplug.guarded_client import GuardedClient
from valvemap.sparkplug.host import PrimaryHost
from valvemap.sparkplug.outbox import Outbox
from valvemap.sparkplug.packet_guard import PacketGuard, PacketRefused
from valvemap.sparkplug.schema import DataType, Payload
from valvemap.sparkplug.sender import _asks_for_births
from valvemap.sparkplug.shown import Shown, Variable
from valvemap.storage import alarm_changes
from valvemap.storage.history_blocks import (
    checksum,
    chosen,
    examine,
    missing_in,
    pack,
    pack_sealed,
    rows_in,
    unpack,
)
from valvemap.storage.history_cells import WIDTHS, cells_of
from valvemap.storage.models import load_model, save_model
from valvemap.storage.points import read_points
from valvemap.storage.recording_writer import RecordingWriter
from valvemap.storage.recordings import read_recording
from valvemap.vocabulary.axis_alarms import AxisAlarm
from valvemap.vocabulary.commands import NAMED
from valvemap.vocabulary.service_alarms import ServiceAlarm

BUDGET = Budget(10_000, 10_000, 100_000, 16)
NOW = datetime(2030, 1, 1, tzinfo=UTC)
VALVE = "Valvistor"
ESTIMATORS = {
    "RLS": RecursiveLeastSquares(),
    "RML": MaximumLikelihood(),
    "RBF": RbfNetwork(),
    "Auto": FlowMap(),
}


@dataclass(frozen=True)
class Decoder:
    """What turns bytes into something: ``seeds`` are valid, ``announced`` is all it may raise.

    ``seal`` makes a mutant's checksum right, so that what lies behind it is reached. ``longest_s``
    is the processor time that no input may exceed, ``inputs`` the number of mutants of the short
    test.
    """

    decode: Callable[[bytes], object]
    seeds: Callable[[], list[bytes]]
    announced: tuple[type[Exception], ...] = ()
    seal: Callable[[bytes], bytes] = bytes
    longest_s: float = 0.01
    inputs: int = 10_000


# Inputs where one takes .1 ms or so, .1 to 1 ms, and 1 to 5 ms: twice as many as brought the last
# new exception or line that raises one, of 10,000, of 10,000 and of 2,000 inputs.
_MANY, _SOME, _FEW = 4_000, 2_000, 600
_TEXT = (UnicodeDecodeError,)  # librdkafka hands over text
_MOST_ROWS_S = 0.1  # a packed column of equal values may rightly have as many rows as any block
_FOREIGN_HEADINGS_S = 0.1  # physics judges some seventy readings of headings that no table knows,
# each with plays, offsets and weights of the pressures, .4-.7 ms a reading


def decoders(folder):
    """Return the table, by name; decoders of files have a place in the folder."""
    return {
        **_of_opc_ua(),
        **_of_states(),
        **_of_files(folder),
        **_of_messages(),
        **_of_history(),
        **_of_kafka(),
    }


def _of_opc_ua():
    status, malformed = ua.UaStatusCodeError, DecodeError
    return {
        "server: requests": Decoder(_request_of_opc_ua, _requests, (status,)),
        "server: values": Decoder(
            lambda data: decode(ua.DataValue, Reader(data, BUDGET)), _values, (status,)
        ),
        "server: index ranges": Decoder(
            lambda data: parse_index_range(_text(data)),
            lambda: [b"1:3,2", b"0"],
            (IndexRangeError,),
        ),
        "client: publish responses": Decoder(
            decoding.decode_publish_response, _publish_responses, (malformed,)
        ),
        "client: republish responses": Decoder(
            decoding.decode_republish_response, _republish_responses, (malformed,)
        ),
        "client: history responses": Decoder(
            lambda data: decoding.decode_history_response(data, [7, 8]),
            _history_responses,
            (malformed, status),
        ),
        "client: data changes": Decoder(
            decoding.decode_data_changes, lambda: [_data_changes()], (malformed,)
        ),
        "client: members of structures": Decoder(_members, lambda: [_structure()]),
        "client: other responses": Decoder(
            _response_of_opc_ua, _responses, (responses.Senseless, status)
        ),
        "client: faults": Decoder(
            responses.check_fault, lambda: [_fault()], (responses.Senseless, status)
        ),
        "client: NodeIds": Decoder(
            lambda data: parse_node_id(_text(data), ("a", "urn:x")),
            lambda: [b"nsu=urn:x;s=V.U", b"ns=1;i=5", b"i=85", b"ns=1;b=AQI="],
            (ConfigurationError, SourceRejected),
        ),
        "client: positions": Decoder(
            lambda data: position_from_bytes(data, "x", 2, 2**62), lambda: [_POSITION]
        ),
    }


_GAUGE = Structure("Gauge", (Field("tag", 12), Field("value", 11)))
_OPTIONAL = Structure("Optional", (Field("x", 11, optional=True),), Form.OPTIONAL)
_STRUCTURE = Structure(
    "Valve",
    (Field("gauges", 22, 1, _GAUGE), Field("said", 24), Field("grid", 4, 2),
     Field("more", 22, 0, _OPTIONAL), Field("U", 4)),
)  # fmt: skip


def _members(data):
    paths = ("U",), ("gauges", 1, "value"), ("more", "x")
    own = frozenset(encodings_of(2, 7))
    wanted = [Member(one, int(kind_of(_STRUCTURE, one)), own, _STRUCTURE) for one in paths]
    return [taken(data, 0, one) for one in wanted]


def _structure():
    gauges = b"".join(b"\2\0\0\0p1" + struct.pack("<d", 1.5) for _ in range(2))
    said = b"\x0c\1\0\0\0x"
    grid = struct.pack("<iII4h", 2, 2, 2, *range(4))
    body = b"\2\0\0\0" + gauges + said + grid + struct.pack("<Id", 1, 2.5) + b"\7\0"
    return b"\x16\1\2\7\0\1" + struct.pack("<i", len(body)) + body


def _of_states():
    """States as checkpoints hold them, restored by their valve."""
    learnt = _learnt()
    keeper = learnt._parts.kept
    doors = {
        "Diagnostics": keeper._take_memory,
        "Signals": keeper._take_timing,
        "Baseline": keeper._take_baseline,
        "Alarms": keeper._take_alarms,
        "Recommended": keeper._take_places,
        "Dynamics": keeper._take_dynamics,
    }
    found = {}
    for kept in learnt.states.kept():
        door = doors.get(kept.estimator, keeper._take_estimator)
        found[f"state: {kept.valve}.{kept.estimator}"] = Decoder(
            lambda data, kept=kept, door=door: door(replace(kept, state=data)),
            lambda kept=kept: [kept.state],
            (StateMismatchError,),
        )
    memory = f"state: {VALVE}.Diagnostics"
    found[memory] = replace(found[memory], inputs=_MANY)
    arrivals = Arrivals([VALVE], Alignment(AlignmentSettings(), optional=(("T",),)))
    arrivals.take(as_changes(plant(20)))
    found["state: axes"] = Decoder(
        partial(Axis(_AXIS).resume, "Press"), lambda: [_packed_axis()], (StateMismatchError,)
    )
    found["state: searches of axes"] = Decoder(
        partial(Axis(_AXIS).resume, SEARCHES),
        lambda: [Searches(3, 1, 40.0).to_bytes(Axis(_AXIS).key)],
        (StateMismatchError,),
        inputs=_MANY,
    )
    found["state: watches of axes"] = Decoder(
        partial(Axis(_AXIS).resume, WATCH),
        lambda: [_packed_watch()],
        (StateMismatchError,),
        inputs=_MANY,
    )
    key, alarms = Axis(_AXIS).key, AxisAlarms()
    alarms.note(1, {AxisAlarm.AXIS_SILENT: 9.0})
    found["state: alarms of axes"] = Decoder(
        partial(Axis(_AXIS).resume, ALARMS),
        lambda: [alarms.to_bytes(key)],
        (StateMismatchError,),
        inputs=_MANY,
    )
    meters = Meters(["m", "m"], [(0.0, 100.0)] * 2)
    meters.share(gathered({0: plant(20)}), lambda valve, error: None)
    found["state: shared meters"] = Decoder(
        lambda data: meters.from_bytes(0, data, "key"),
        lambda: [bytes(meters.to_bytes(0, "key") or b"")],
        (StateMismatchError,),
    )
    found["state: arrays"] = Decoder(_arrays_of, _arrays, (StateMismatchError,))
    found["state: arrivals"] = Decoder(
        arrivals.resume,
        lambda: [arrivals.to_bytes()],
        (StateMismatchError,),
        _with_crc,
        inputs=_SOME,
    )
    return found


_AXIS = AxisPlan("Press", AxisGeometry(63.0, 45.0, 800.0, 1.2, 1.2))


def _packed_axis():
    regression = AxisRegression(_AXIS.geometry, play_percent=2.0, spool_hz=40.0)
    of_shape = np.zeros((SIZE, SIZE))
    learnt = kept_axes.Learnt(regression, regression.initial_state(), of_shape)
    return kept_axes.pack(learnt, Axis(_AXIS).key)


def _packed_watch():
    regression = AxisRegression(_AXIS.geometry, play_percent=2.0, spool_hz=40.0)
    square, state = np.zeros((SIZE, SIZE)), regression.initial_state()
    reference = Reference(np.zeros(SIZE), np.eye(SIZE), 1.0, 1.0)
    sums = AxisWindowSums(state, ForceState.initial())
    watch = AxisWatch(regression, 1800.0, square, reference, sums, sums, Condition.initial())
    return pack_watch(watch, Axis(_AXIS).key)


def _of_history():
    """Columns of a block and alarms' changes, under the checksums that belong to them."""
    return {
        "history: blocks": Decoder(_block_of, lambda: [_block()], inputs=_SOME),
        "history: sealed blocks": Decoder(
            _block_of, lambda: [_sealed_block(), _tier()], longest_s=_MOST_ROWS_S, inputs=_FEW
        ),
        "history: alarms": Decoder(_alarms_of(sqlite3.connect(":memory:")), lambda: [_alarm()]),
    }


def _of_files(folder):
    number = count()

    def of_file(name, read, seeds, *announced):
        file = folder / f"{next(number)}-{name}"

        def decode_file(data):
            file.write_bytes(data)
            return read(file)

        return Decoder(decode_file, seeds, announced)

    pki = Pki(folder / "pki")
    pki.make_folders()
    csv = of_file("r.csv", _rows, lambda: [_CSV, _DATES], RecordingError)
    packed = of_file("r.csv.gz", _rows, lambda: [gzip.compress(_CSV)], RecordingError)
    parquet = of_file("r.parquet", _rows, lambda: [_parquet(folder)], RecordingError)
    models = of_file("m.json", load_model, lambda: _models(folder), StorageError)
    configuration = of_file("c.toml", load_config, lambda: [_CONFIGURATION], ConfigurationError)
    return {
        "file: CSV": replace(csv, longest_s=_FOREIGN_HEADINGS_S, inputs=_FEW),
        "file: CSV.gz": replace(packed, longest_s=_FOREIGN_HEADINGS_S, inputs=_SOME),
        "file: Parquet": replace(parquet, longest_s=_FOREIGN_HEADINGS_S, inputs=_FEW),
        "file: points": of_file("p.csv", read_points, lambda: [_POINTS], StorageError),
        "file: models": replace(models, inputs=_FEW),
        "file: users": of_file(
            "users.json", UserStore.load, lambda: [_users(folder)], hardened.ConfigurationError
        ),
        "file: configuration": replace(configuration, inputs=_SOME),
        "file: certificates": of_file(
            "c.der",
            load_certificate,
            lambda: [_shown(), *_pem()],
            hardened.CertificateError,
        ),
        "file: trusted certificates": Decoder(
            _in_folder(pki, "a.der"), lambda: [_shown()], inputs=_SOME
        ),
        "file: revocation lists": Decoder(
            _in_folder(pki, "a.crl"), lambda: [_revocations()], inputs=_SOME
        ),
        "wire: certificates": Decoder(
            parse, lambda: [_shown(), 2 * _shown()], (CertificateRefused,)
        ),
    }


def _of_messages():
    return {
        "page: requests": Decoder(
            lambda data: request_of(_text(data)),
            lambda: [b'{"valve": "V1", "estimator": "RLS"}'],
            (SenselessRequest,),
        ),
        "Sparkplug: states": Decoder(
            PrimaryHost("SCADA").hear, lambda: [b'{"online": true, "timestamp": 5}']
        ),
        "Sparkplug: commands": Decoder(_asks_for_births, lambda: [_command()]),
        "Sparkplug: device commands": Decoder(_device_commands(), _demands),
        "MQTT: packets": Decoder(
            lambda data: PacketGuard("mqtt://x").receive(data), _packets, (PacketRefused,)
        ),
        "MQTT: client": Decoder(_read_by_client, _packets),
    }


def _of_kafka():
    samples = ByValve(plant(30), Segments.one(30))
    columns = {"x": np.ones((1, 3)), "n": np.ones((1, 9), np.int64)}
    memory = Memory(
        1, 2, {"a": 5}, {"b": 7}, [Columns("k", (VALVE,), columns)], {VALVE: b"baseline"}, ["r"]
    )
    command = Command("1", "north.0", VALVE, "demand", "", (60.0, 100.0))
    reply = Reply("7", "north.0", 12, done=True)
    block = (BlockError,)
    return {
        "Kafka: samples": Decoder(
            read_samples,
            lambda: [write_samples(SamplesBlock("north.0", 7, (VALVE,), samples))],
            block,
        ),
        "Kafka: results": Decoder(read_results, _results, block),
        "Kafka: commands": Decoder(read_command, lambda: [write_message(command)], block),
        "Kafka: statistics": Decoder(
            lambda data: read_statistics(data.decode()), _statistics, _TEXT
        ),
        "Kafka: replies": Decoder(read_reply, lambda: [write_message(reply)], block),
        "Kafka: memories": Decoder(
            read_memory, lambda: [write_memory(memory)], (FleetError,), _with_seal
        ),
        "Kafka: states": Decoder(
            _fresh_group().remember,
            lambda: [_learnt_group().to_bytes()],
            (FleetError,),
            _with_seal,
            inputs=_SOME,
        ),
    }


def _statistics():
    one = {"desired": True, "ls_offset": 9, "app_offset": 2, "next_offset": 3, "fetchq_cnt": 2}
    topics = {"valvemap.samples": {"partitions": {"0": one, "-1": {"desired": False}}}}
    return [json.dumps({"msg_cnt": 4, "topics": topics}).encode()]


def _results():
    (results,) = _learnt().results.of([0])
    return [write_results(ResultsBlock("north.0", 9, (VALVE,), results))]


_POSITION = json.dumps(
    {
        "format": 1,
        "binding": "x",
        "known_to": [1, 2],
        "subscription": {
            "number": 1,
            "message": 2,
            "publishing_interval_ms": 100.0,
            "keep_alive_count": 10,
            "items": [[0, 1, 10, 5], [1, 2, 10, 6]],
        },
    }
).encode()
_CSV = b"t,U,p1,p2,Q,T\n" + b"".join(
    b"%d,%d.5,200,%d,1e1,40\n" % (1_800_000_000_000_000_000 + k, k, 100 - k) for k in range(20)
)
_DATES = b"t;U;p1;p2;Q\n2026-11-22T10:00:00.25Z;1,5;2;3;4\n2026-11-22T10:00:01Z;1,5;2;3;4\n"
_POINTS = b"Q,dp,T\n10,100,40\n20.5,1e2,\n"
_CONFIGURATION = b'[[valves]]\nname = "V1"\n[alignment]\nmax_wait_s = 0.5\n'


def _text(data):
    return data.decode("utf-8", "surrogateescape")


_KINDS = {
    kind().TypeId.Identifier: kind
    for kind in {type(make(ua.NodeId())) for make in requests(ua.NodeId(5, 2))}
}
_RESPONSES = {
    kind().TypeId.Identifier: kind
    for kind in (ua.ReadResponse, ua.BrowseResponse, ua.CreateMonitoredItemsResponse)
}


def _request_of_opc_ua(data):
    number = decode(ua.NodeId, Reader(data, BUDGET)).Identifier
    return decode(_KINDS.get(number, ua.ReadRequest), Reader(data, BUDGET))


def _requests():
    made = requests(ua.NodeId("Plant.Flow", 2))
    return [ua_binary.struct_to_binary(make(ua.NodeId(b"token", 0))) for make in made]


def _data_values():
    contents = (
        ua.Variant(1.5, ua.VariantType.Double),
        ua.Variant([1, 2, 3], ua.VariantType.Int32),
        ua.Variant([[1.0, 2.0], [3.0, 4.0]], ua.VariantType.Double),
        ua.Variant("text"),
        ua.Variant(NOW),
        ua.Variant(ua.NodeId("x", 3)),
        ua.Variant(ua.LocalizedText("a", "en")),
        ua.Variant(ua.Range(0.0, 1.0)),
        ua.Variant([ua.Variant(1), ua.Variant("x")], ua.VariantType.Variant, is_array=True),
    )
    return [ua.DataValue(one, SourceTimestamp=NOW, ServerTimestamp=NOW) for one in contents]


def _values():
    return [ua_binary.struct_to_binary(value) for value in _data_values()]


def _data_changes():
    items = [ua.MonitoredItemNotification(k, value) for k, value in enumerate(_data_values())]
    change = ua.DataChangeNotification(MonitoredItems=items)
    # a time with picoseconds
    record = struct.pack("<IBBdqH", 9, 0x15, 11, 1.0, 2**60, 65_535)
    body = ua_binary.struct_to_binary(change)
    return struct.pack("<i", len(items) + 1) + record + body[4:]


def _message(response):
    body = ua.ExtensionObject(
        ua.NodeId(ua.ObjectIds.DataChangeNotification_Encoding_DefaultBinary), _data_changes()
    )
    message = ua.NotificationMessage(SequenceNumber=5, PublishTime=NOW, NotificationData=[body])
    holder = response if hasattr(response, "NotificationMessage") else response.Parameters
    holder.NotificationMessage = message
    return response


def _publish_responses():
    response = _message(ua.PublishResponse())
    response.Parameters.AvailableSequenceNumbers = [4, 5]
    response.Parameters.Results = [ua.StatusCode()]
    return [ua_binary.struct_to_binary(response)]


def _republish_responses():
    return [ua_binary.struct_to_binary(_message(ua.RepublishResponse()))]


def _history_responses():
    data = ua.HistoryData(DataValues=_data_values()[:1] * 3)
    kind = ua.NodeId(ua.ObjectIds.HistoryData_Encoding_DefaultBinary)
    held = ua.ExtensionObject(kind, ua_binary.struct_to_binary(data))
    result = ua.HistoryReadResult(ua.StatusCode(), b"point", held)
    return [ua_binary.struct_to_binary(ua.HistoryReadResponse(Results=[result, result]))]


def _response_of_opc_ua(data):
    number = responses.decode_type(data).Identifier
    return responses.decode_response(_RESPONSES.get(number, ua.ReadResponse), data)


def _responses():
    reference = ua.ReferenceDescription(BrowseName=ua.QualifiedName("V1", 2))
    browse = ua.BrowseResponse(Results=[ua.BrowseResult(References=[reference])])
    item = ua.MonitoredItemCreateResult(MonitoredItemId=1, RevisedQueueSize=10)
    made = (
        ua.ReadResponse(Results=_data_values()),
        browse,
        ua.CreateMonitoredItemsResponse(Results=[item]),
    )
    return [ua_binary.struct_to_binary(one) for one in made]


def _fault():
    fault = ua.ServiceFault()
    fault.ResponseHeader.ServiceResult = ua.StatusCode(ua.StatusCodes.BadInternalError)
    return ua_binary.struct_to_binary(fault)


@dataclass(frozen=True)
class _Arrays(State):
    """A state of one array, whose type and shape the bytes decide."""

    array: np.ndarray


def _arrays():
    """Records that numpy reads, with arrays of all its plain types."""
    kinds = ("<f8", ">f4", "<i8", "<u2", "|b1", "|S3", "<U4", "<c16", "<M8[ns]", "<m8[s]", "<f2")
    shapes = ((), (0,), (3,), (2, 3))
    return [_Arrays(np.zeros(shape, kind)).to_bytes("key") for kind in kinds for shape in shapes]


def _arrays_of(data):
    found = _Arrays.from_bytes(data, "key")
    found.check(_Arrays(np.zeros(found.array.shape, found.array.dtype)))


def _fresh_group():
    return group(catalogue(1, estimators=(RlsConfig(),)).groups["north.0"])


def _learnt_group():
    learnt = _fresh_group()
    feed(learnt, [block(learnt.plan, 1, (30,))])
    return learnt


def _models(folder):
    found = []
    for name, samples in (("RLS", 40), ("RBF", 40), ("Auto", 300)):
        learnt = _learnt(samples)
        lane, file = learnt.valves.lane(VALVE, name), folder / f"seed-{name}.json"
        save_model(file, VALVE, name, lane.estimator, lane.state, lane.spread, lane.support)
        said = json.loads(file.read_bytes())
        found.append(json.dumps(said, separators=(",", ":")).encode())
    return found


_COLUMNS = ("t", "codes", "U", "p1", "p2", "dp", "Q")


def _block():
    """The columns of a loose block, each behind its length."""
    t, rows = START + np.arange(50) * 10_000_000, np.ones(50)
    return _behind_lengths(
        {"t": pack("t", t), "codes": pack("codes", rows.astype(np.uint32)), "U": pack("U", rows)}
    )


def _sealed_block():
    """The columns of a sealed block in all forms: times, steps, bits, and following from others."""
    rng, t = np.random.default_rng(1), START + np.arange(50) * 10_000_000
    p1, p2 = np.round(rng.normal(200.0, 1.0, (2, 50)), 2)
    single = np.round(rng.normal(size=50), 2).astype(np.float32).astype(float)
    columns = {"t": t, "codes": np.zeros(50, np.uint32), "U": rng.normal(size=50)}
    return _behind_lengths(pack_sealed({**columns, "p1": p1, "p2": p2, "dp": p1 - p2, "Q": single}))


def _tier():
    """The cells of a block under the names of columns."""
    t, values = START + np.arange(500) * 10**9, np.arange(500.0)
    cells = cells_of({"t": t, "codes": np.zeros(500, np.uint32), "Q": values}, WIDTHS[0])
    some = dict(zip(_COLUMNS, cells.values(), strict=False))
    return _behind_lengths(pack_sealed(some))


def _behind_lengths(columns):
    return b"".join(
        struct.pack("<H", len(columns.get(name, b""))) + columns.get(name, b"") for name in _COLUMNS
    )


def _block_of(data):
    """Examine columns whose checksums are right, and read them."""
    parts, at = {}, 0
    for name in _COLUMNS:
        (length,) = struct.unpack_from("<H", data.ljust(at + 2, b"\0"), at)
        parts[name] = data[at + 2 : at + 2 + length]
        at += 2 + length
    try:
        first = int(unpack("t", parts["t"])[0])
    except (zlib.error, ValueError, IndexError):
        first = 0
    checked = {n: (checksum(x, "V1.Signals", n, first), x) for n, x in parts.items()}
    missing_in(checked)
    found = examine("V1.Signals", checked)
    for name, one in found.parts.items():
        rows_in(one)
        assert len(found.columns[name]) == len(found.t)
        assert len(unpack(name, one, found.columns)) == len(found.t)
    if len(found.t) and len(found.columns) > 2:
        cells_of(found.columns, WIDTHS[0])
        chosen(found, np.arange(len(found.t)) % 2 == 0)


def _alarm():
    report = AlarmReport("Changed", True, False, 600, START, START, 1, "The flow changed")  # noqa: FBT003
    return json.dumps(asdict(report)).encode()


def _alarms_of(file):
    """Select a change whose checksum is right from a file."""
    alarm_changes.prepare(file)

    def select(data):
        text = data.decode("utf-8", "replace")
        row = 1, START, "V1", "digest", text, zlib.crc32(text.encode("utf-8", "replace"))
        file.execute("INSERT OR REPLACE INTO alarm_change VALUES (?, ?, ?, ?, ?, ?)", row)
        alarm_changes.select(file, None, (0, 2**62), backwards=False, skip=0, most=10)

    return select


def _learnt(samples=300):
    plan = ValvePlan(name=VALVE, gate=QualityGate(), estimators=ESTIMATORS, inverse="RLS")
    alignment = Alignment(AlignmentSettings(), optional=(("T",),))
    learnt = Identification([plan], alignment, Timing(TimingSettings(), (("T",),)))
    learnt.take_samples(0, plant(samples))
    learnt.maps.refresh()
    learnt.do(operator_ports.Command.of("approve", VALVE))
    learnt._parts.references.of[0] = DynamicsReference(
        np.array(20.0), np.array(0.1), np.array(9, np.int64)
    )
    learnt._parts.alarms.of_service.note(0, {ServiceAlarm.CHECKPOINT: 1e9})
    return learnt


def _with_crc(data):
    return zlib.crc32(data[4:]).to_bytes(4, "big") + data[4:]


def _with_seal(data):
    return sealed(data[len(sealed()) :])


def _rows(file):
    with read_recording(file) as recording:
        return list(recording)


def _parquet(folder):
    file = folder / "seed.parquet"
    with RecordingWriter(file) as writer:
        writer.append("V1", plant(50))
    return file.read_bytes()


def _users(folder):
    store, file = UserStore(), folder / "seed.json"
    store.add("olga", Role.OPERATOR, "correct horse")
    store.save(file)
    return file.read_bytes()


def _shown():
    return certificates.der(certificates.self_signed().certificate)


def _pem():
    certificate = certificates.self_signed().certificate
    return [certificate.public_bytes(serialization.Encoding.PEM)]


def _revocations():
    authority = certificates.root()
    crl = certificates.make_crl(authority, [certificates.revocation(authority)])
    return crl.public_bytes(serialization.Encoding.DER)


def _in_folder(pki, name):
    folders, file = TrustFolders(pki), pki.trusted / name

    def read_folder(data):
        file.write_bytes(data)
        return folders.lists()

    return read_folder


def _command():
    payload = Payload(timestamp=5)
    payload.metrics.add(name="Node Control/Rebirth", datatype=11, boolean_value=True)
    return payload.SerializeToString()


def _demands():
    """A demand by name, and one by alias in an instance of a template."""
    payload, instance = Payload(timestamp=5), Payload(timestamp=5)
    payload.metrics.add(name="Inverse/FlowDemand", datatype=10, double_value=60.0)
    payload.metrics.add(name="Alarms/Changed/Acknowledge", datatype=12, string_value="seen")
    template = instance.metrics.add(alias=2**24, datatype=19).template_value
    template.metrics.add(alias=1, double_value=60.0)
    return [payload.SerializeToString(), instance.SerializeToString()]


def _device_commands():
    """Check commands to a valve with a demand, and take those that are valid."""
    shown = Shown(Outbox(10), 0)
    demand = NAMED["demand"]
    flow = Variable("V1.Q", "V1", "Inverse/FlowDemand", DataType.DOUBLE, action=demand)
    shown.find([flow], {}, 0)

    def hear(data):
        commands = Commands(("demand",), shown, "Valve/", max_age_s=600.0)
        commands.hear("V1", Message("topic", data), 0)
        return list(commands.take(0))

    return hear


def _packets():
    """CONNACK, SUBACK, PINGRESP, PUBLISH of QoS 0 and 1, PUBACK, and all of them together."""
    topic = b"\x00\x05STATE"
    found = [
        b"\x20\x02\x00\x00",
        b"\x90\x03\x00\x01\x01",
        b"\xd0\x00",
        bytes([0x30, len(topic) + 2]) + topic + b"{}",
        bytes([0x32, len(topic) + 4]) + topic + b"\x00\x07{}",
        b"\x40\x02\x00\x01",
    ]
    return [*found, b"".join(found)]


class _Wire:
    """A socket that has received some bytes, and then nothing more."""

    def __init__(self, data):
        self._data = data

    def recv(self, size):
        taken, self._data = self._data[:size], self._data[size:]
        if not taken:
            raise BlockingIOError
        return taken

    def send(self, data):
        return len(data)

    def fileno(self):
        return -1

    def close(self):
        self._data = b""


def _read_by_client(data):
    """Have the MQTT client read packets, as its thread does."""
    client = GuardedClient(
        PacketGuard("mqtt://x"),
        CallbackAPIVersion.VERSION2,
        client_id="x",
        protocol=MQTTv311,
        reconnect_on_failure=False,
    )
    client._sock = wire = _Wire(data)
    try:
        while client._sock is wire and wire._data:
            client.loop_read()
    finally:
        client._reset_sockets()
