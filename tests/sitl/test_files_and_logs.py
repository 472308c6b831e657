"""MAVLink FTP and log download, refused properly: an answer at once, so that clients give up at once."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mavlink

from sitl.services.files import Error, Opcode, refusal
from tests.sitl.client import Direct

HEADER = struct.Struct("<HBBBBBBI")


def ftp(client: Direct, opcode: int, data: bytes = b"", sequence: int = 5, session: int = 0) -> tuple[int, ...]:
    """A request; the answer's sequence, session, opcode, size, req_opcode and first data byte."""
    payload = HEADER.pack(sequence, session, opcode, len(data), 0, 0, 0, 0) + data
    client.latest.pop("FILE_TRANSFER_PROTOCOL", None)
    client.send(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, list(payload.ljust(251, b"\0"))))
    client.advance()
    answer = client.latest["FILE_TRANSFER_PROTOCOL"]
    assert (answer.target_system, answer.target_component) == (240, 191)
    raw = bytes(answer.payload)
    sequence, session, opcode, size, requested, *_ = HEADER.unpack_from(raw)
    return sequence, session, opcode, size, requested, raw[HEADER.size]


@pytest.mark.parametrize(
    ("opcode", "data", "error"),
    [
        (Opcode.OPEN_FILE_RO, b"@PARAM/param.pck", Error.FILE_NOT_FOUND),
        (Opcode.OPEN_FILE_RO, b"/etc/extras/component_general.json.xz", Error.FILE_NOT_FOUND),
        (Opcode.LIST_DIRECTORY, b"/", Error.EOF),
        (Opcode.LIST_DIRECTORY, b"/fs/microsd", Error.FILE_NOT_FOUND),
        (Opcode.READ_FILE, b"", Error.INVALID_SESSION),
        (Opcode.BURST_READ_FILE, b"", Error.INVALID_SESSION),
        (Opcode.TERMINATE_SESSION, b"", Error.INVALID_SESSION),
        (Opcode.CREATE_FILE, b"/x", Error.FILE_PROTECTED),
        (Opcode.CREATE_DIRECTORY, b"/x", Error.FILE_PROTECTED),
        (77, b"", Error.UNKNOWN_COMMAND),
    ],
)
def test_ftp_is_refused_with_the_protocols_own_reason(vehicle, opcode, data, error):
    """The answer mirrors session and opcode, counts the sequence on, and says why in one byte."""
    assert ftp(vehicle, opcode, data, 65535, 3) == (0, 3, 129, 1, opcode, error)


@pytest.mark.parametrize("opcode", [Opcode.NONE, Opcode.RESET_SESSIONS])
def test_ftp_requests_that_need_no_file_succeed(vehicle, opcode):
    assert ftp(vehicle, opcode)[2:5] == (128, 0, opcode)


def test_a_repeated_ftp_request_gets_the_same_answer(vehicle):
    assert ftp(vehicle, Opcode.OPEN_FILE_RO, b"/x") == ftp(vehicle, Opcode.OPEN_FILE_RO, b"/x")


def test_an_ftp_answer_is_not_answered(vehicle):
    """Or two vehicles that hear each other would talk for ever."""
    with pytest.raises(KeyError):
        ftp(vehicle, 129)


@given(st.integers(0, 255), st.binary(max_size=239))
def test_every_ftp_opcode_has_an_answer(opcode, path):
    assert refusal(opcode, path) in {*Error, None}


def test_there_are_no_logs(vehicle):
    vehicle.send(mavlink.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    vehicle.advance()
    entry = vehicle.latest["LOG_ENTRY"]
    assert (entry.num_logs, entry.last_log_num, entry.size) == (0, 0, 0)
    vehicle.send(mavlink.MAVLink_log_request_data_message(1, 1, 4, 90, 900))
    vehicle.send(mavlink.MAVLink_log_erase_message(1, 1))
    vehicle.send(mavlink.MAVLink_log_request_end_message(1, 1))
    vehicle.advance()
    data = vehicle.latest["LOG_DATA"]
    assert (data.id, data.ofs, data.count) == (4, 90, 0)
