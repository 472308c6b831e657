"""MAVLink FTP over a file system that is empty and cannot be written: whatever is asked is refused at once.

Clients that look for files first (parameter or mission files, component information) then fall back to the plain
protocols. Answers depend on the request alone, so that a repeated one is answered alike (mavlink.io, "FTP").
"""

import struct
from enum import IntEnum

from sitl.links.frames import Message, pack
from sitl.links.link import Link
from sitl.vehicle import Vehicle

_HEADER = struct.Struct("<HBBBBBBI")
"""seq_number, session, opcode, size, req_opcode, burst_complete, padding, offset."""
PAYLOAD_BYTES = 251
ACK, NAK = 128, 129


class Opcode(IntEnum):
    """What is asked; the numbers missing here are of no use without files."""

    NONE = 0
    TERMINATE_SESSION = 1
    RESET_SESSIONS = 2
    LIST_DIRECTORY = 3
    OPEN_FILE_RO = 4
    READ_FILE = 5
    CREATE_FILE = 6
    WRITE_FILE = 7
    REMOVE_FILE = 8
    CREATE_DIRECTORY = 9
    REMOVE_DIRECTORY = 10
    OPEN_FILE_WO = 11
    TRUNCATE_FILE = 12
    RENAME = 13
    CALC_FILE_CRC32 = 14
    BURST_READ_FILE = 15


class Error(IntEnum):
    """Why not."""

    INVALID_SESSION = 4
    EOF = 6
    UNKNOWN_COMMAND = 7
    FILE_PROTECTED = 9
    FILE_NOT_FOUND = 10


REFUSALS = {
    Opcode.TERMINATE_SESSION: Error.INVALID_SESSION,
    Opcode.OPEN_FILE_RO: Error.FILE_NOT_FOUND,
    Opcode.READ_FILE: Error.INVALID_SESSION,
    Opcode.CREATE_FILE: Error.FILE_PROTECTED,
    Opcode.WRITE_FILE: Error.INVALID_SESSION,
    Opcode.REMOVE_FILE: Error.FILE_NOT_FOUND,
    Opcode.CREATE_DIRECTORY: Error.FILE_PROTECTED,
    Opcode.REMOVE_DIRECTORY: Error.FILE_NOT_FOUND,
    Opcode.OPEN_FILE_WO: Error.FILE_PROTECTED,
    Opcode.TRUNCATE_FILE: Error.FILE_NOT_FOUND,
    Opcode.RENAME: Error.FILE_NOT_FOUND,
    Opcode.CALC_FILE_CRC32: Error.FILE_NOT_FOUND,
    Opcode.BURST_READ_FILE: Error.INVALID_SESSION,
}


def refusal(opcode: int, path: bytes) -> Error | None:
    """Why a request fails; None for the two that need no file."""
    if opcode in (Opcode.NONE, Opcode.RESET_SESSIONS):
        return None
    if opcode == Opcode.LIST_DIRECTORY:
        return Error.FILE_NOT_FOUND if path.strip(b"/\0") else Error.EOF
    return REFUSALS.get(Opcode(opcode), Error.UNKNOWN_COMMAND) if opcode in set(Opcode) else Error.UNKNOWN_COMMAND


def file_transfer_protocol(_: Vehicle, link: Link, message: Message) -> None:
    """One answer per request; what is itself an answer is not answered."""
    raw = bytes(message.payload)
    sequence, session, opcode, size, *_rest = _HEADER.unpack_from(raw)
    if opcode in (ACK, NAK):
        return
    error = refusal(opcode, raw[_HEADER.size : _HEADER.size + size])
    data = b"" if error is None else bytes((error,))
    answer = _HEADER.pack(sequence + 1 & 0xFFFF, session, NAK if data else ACK, len(data), opcode, 0, 0, 0) + data
    link.send(
        pack(
            "FILE_TRANSFER_PROTOCOL",
            target_network=0,
            target_system=message.get_srcSystem(),
            target_component=message.get_srcComponent(),
            payload=list(answer.ljust(PAYLOAD_BYTES, b"\0")),
        )
    )
