"""The standard address space: parsed once, then loaded from the user's cache."""

import asyncio
import gc
import os
import pickle
import stat
import sys
import tempfile
import zlib
from importlib.metadata import version
from pathlib import Path

from asyncua import ua
from asyncua.server.address_space import AddressSpace, NodeManagementService
from asyncua.server.standard_address_space import standard_address_space

from guarded_opcua.address_space.packed_nodes import PackedNodes, pack
from guarded_opcua.logs import bounded_logger
from guarded_opcua.security.whole_files import write_owner_only

_log = bounded_logger(__name__)
_Ids = ua.ObjectIds
_PART_OF = {
    ua.NodeId(_Ids.HasComponent),
    ua.NodeId(_Ids.HasOrderedComponent),
    ua.NodeId(_Ids.HasProperty),
    ua.NodeId(_Ids.HasAddIn),
}
_FACILITIES_NOT_OFFERED = (
    *(_Ids.ServerConfiguration, _Ids.PublishSubscribe, _Ids.Resources, _Ids.Aliases),
    *(_Ids.ServerLog,),
)
_METHODS_OFFERED = {ua.NodeId(_Ids.Server_GetMonitoredItems), ua.NodeId(_Ids.Server_ResendData)}
_FORMAT = 4  # increment when the preparation below changes


async def load_standard_address_space(
    aspace: AddressSpace, management: NodeManagementService, folder: Path | None
) -> None:
    """Fill an address space with the standard nodes, from the cache if it is trusted.

    The cache is a pickle, so it is loaded only if the user owns the file and its folder and no
    other user can write to them.
    """
    file = (folder or user_cache_folder()) / _file_name()
    gc_was_enabled = gc.isenabled()
    gc.disable()  # half a million new objects, none of them garbage: three times faster
    try:
        packed = _read(file)
        if packed is None:
            await asyncio.to_thread(standard_address_space.fill_address_space, management)
            _close_for_writing(aspace)
            _drop(aspace, _not_offered(aspace))
            packed = pack(aspace._nodes)  # noqa: SLF001 - as AddressSpace.dump does
            _write(file, packed)
        aspace._nodes = PackedNodes(packed)  # noqa: SLF001 - as AddressSpace.load does
    finally:
        if gc_was_enabled:
            gc.enable()
        gc.freeze()  # a full collection over these nodes would block the event loop for 0.2 s


def user_cache_folder() -> Path:
    """Return the user's cache folder on this platform."""
    if sys.platform == "win32":
        return (
            Path(os.environ.get("LOCALAPPDATA", tempfile.gettempdir())) / "hardened-opcua" / "Cache"
        )
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "hardened-opcua"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hardened-opcua"


def _file_name() -> str:
    python = f"{sys.implementation.cache_tag}"
    return f"address-space-{version('asyncua')}-{python}-{_FORMAT}.pickle"


def _read(file: Path) -> dict[ua.NodeId, bytes] | None:
    if not _ours(file.parent, directory=True) or not _ours(file, directory=False):
        return None
    try:
        content = file.read_bytes()
        if zlib.crc32(content[4:]) != int.from_bytes(content[:4]):
            raise ValueError("its checksum is wrong")  # noqa: TRY301 - as any other damage
        packed = pickle.loads(content[4:])  # noqa: S301 - only a file of this user, see above
    except Exception as error:  # noqa: BLE001 - a damaged pickle raises anything
        _log.warning("%s: damaged, created again: %s", file, error)
        return None
    return packed if isinstance(packed, dict) else None


def _write(file: Path, packed: dict[ua.NodeId, bytes]) -> None:
    try:
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _ours(file.parent, directory=True):
            _log.warning("%s: not the user's own folder, nothing is kept there", file.parent)
            return
        content = pickle.dumps(packed, pickle.HIGHEST_PROTOCOL)
        write_owner_only(file, zlib.crc32(content).to_bytes(4) + content)
    except OSError as error:
        _log.warning("%s: cannot be written: %s", file, error.strerror)


def _ours(path: Path, *, directory: bool) -> bool:
    try:
        status = path.lstat()
    except OSError:
        return False
    right_kind = stat.S_ISDIR(status.st_mode) if directory else stat.S_ISREG(status.st_mode)
    if sys.platform == "win32":
        return right_kind  # the access control list of %LOCALAPPDATA% protects it
    forbidden = stat.S_IWGRP | stat.S_IWOTH
    return right_kind and status.st_uid == os.geteuid() and not status.st_mode & forbidden


def _close_for_writing(aspace: AddressSpace) -> None:
    """Set the access levels of the standard variables to read-only."""
    writing = 1 << ua.AccessLevel.CurrentWrite | 1 << ua.AccessLevel.HistoryWrite
    for attribute in (ua.AttributeIds.AccessLevel, ua.AttributeIds.UserAccessLevel):
        for nodeid in list(aspace.keys()):
            held = aspace[nodeid].attributes.get(attribute)
            if held is None or held.value is None or held.value.Value is None:
                continue
            level = held.value.Value.Value
            if isinstance(level, int) and level & writing:
                held.value = ua.DataValue(ua.Variant(level & ~writing, ua.VariantType.Byte))


def _not_offered(aspace: AddressSpace) -> set[ua.NodeId]:
    """Return the objects of facilities, and all methods below Objects, that are not implemented."""
    gone = {ua.NodeId(facility) for facility in _FACILITIES_NOT_OFFERED}
    waiting, seen = [ua.NodeId(_Ids.ObjectsFolder)], set[ua.NodeId]()
    while waiting:
        here = waiting.pop()
        if here in seen or here in gone or here not in aspace:
            continue
        seen.add(here)
        for part in aspace[here].references:
            if not part.IsForward or part.ReferenceTypeId == ua.NodeId(_Ids.HasTypeDefinition):
                continue
            if part.NodeClass != ua.NodeClass.Method:
                waiting.append(part.NodeId)
            elif part.NodeId not in _METHODS_OFFERED:
                gone.add(part.NodeId)
    return gone


def _drop(aspace: AddressSpace, gone: set[ua.NodeId]) -> None:
    """Remove nodes with their parts, and all references to them."""
    waiting = [node for node in gone if node in aspace]
    gone = set(waiting)
    while waiting:
        for part in aspace[waiting.pop()].references:
            if part.IsForward and part.ReferenceTypeId in _PART_OF and part.NodeId not in gone:
                gone.add(part.NodeId)
                waiting.append(part.NodeId)
    for node in gone:
        del aspace[node]
    for node in list(aspace.keys()):
        own = aspace[node].references
        own[:] = [reference for reference in own if reference.NodeId not in gone]
