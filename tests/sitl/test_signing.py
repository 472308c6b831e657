"""MAVLink 2 signing, with pymavlink on the other side; rules of mavlink.io "Message Signing", AUTOPILOT.md 6."""

import hashlib
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mavlink

from sitl.links.frames import SIGNED, Frame, frame, pack, split
from sitl.links.signing import EPOCH_2015_US, NEW_STREAM_LATE_MAX, Signing, read_key
from tests.sitl.client import Direct, lockstep
from tests.sitl.process import sitl_process

KEY = hashlib.sha256(b"a passphrase").digest()
NOW = 40_000_000_000_000
"""10 us since 2015: about 2027."""
HEARTBEAT = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def set_up(client: Direct, key: bytes = KEY, timestamp: int = NOW, system: int = 1) -> None:
    client.send(mavlink.MAVLink_setup_signing_message(system, 1, list(key), timestamp))
    client.fly(0.1)


def sign_with_pymavlink(client: Direct, key: bytes = KEY, timestamp: int = NOW, link_id: int = 3) -> None:
    """As `mavfile.setup_signing` does; what comes in unsigned is refused, too."""
    signing = client.mav.signing
    signing.secret_key, signing.link_id, signing.timestamp = key, link_id, timestamp
    signing.sign_outgoing = True
    signing.allow_unsigned_callback = None


def answered(client: Direct) -> bool:
    """Whether a command gets its ACK."""
    return client.command(512, 148) is not None


def counted(client: Direct, name: str) -> int:
    return client.link.counters[name]


@pytest.fixture
def signed(vehicle: Direct) -> Direct:
    """A vehicle with a key, and a client that has it."""
    vehicle.boot()
    set_up(vehicle)
    sign_with_pymavlink(vehicle)
    vehicle.latest.clear()
    vehicle.messages.clear()
    return vehicle


def test_before_a_key_is_set_all_is_accepted_and_nothing_is_signed(vehicle):
    """Frames signed by a client with whatever key, too."""
    vehicle.boot()
    assert answered(vehicle)
    vehicle.mav.signing.secret_key, vehicle.mav.signing.sign_outgoing = KEY, True
    vehicle.mav.signing.allow_unsigned_callback = lambda *_: True
    assert answered(vehicle)
    assert not any(raw[2] & SIGNED for raw in vehicle.raw)


def test_both_directions_are_signed_and_believed(signed):
    """pymavlink checks every signature and timestamp of ours, and refuses what is not signed."""
    assert answered(signed)
    signed.fly(2)
    assert signed.mav.signing.badsig_count == 0
    assert signed.mav.signing.goodsig_count > 100


def test_a_signed_flight(signed):
    signed.take_off(495.0)
    signed.offboard(1.0, 0.0, 0.0)
    signed.fly(2, lambda: signed.setpoint(1.0, 0.0, 0.0))
    assert signed.mode == (6, 0)


def test_unsigned_frames_are_refused_but_for_those_that_command_nothing(signed):
    signed.mav.signing.sign_outgoing = False
    assert not answered(signed)
    assert counted(signed, "unsigned") == 1
    before = counted(signed, "received")
    signed.send(mavlink.MAVLink_radio_status_message(1, 1, 1, 1, 1, 1, 1))
    signed.send(HEARTBEAT)
    signed.fly(0.1)
    assert counted(signed, "unsigned") == 2
    assert counted(signed, "received") == before + 2


def test_mavlink_1_cannot_be_signed(signed):
    signed.udp.sendto(HEARTBEAT.pack(signed.mav, force_mavlink1=True), signed.to)
    signed.fly(0.1)
    assert counted(signed, "unsigned") == 1


def test_a_wrong_key_is_refused(signed):
    sign_with_pymavlink(signed, bytes(32), NOW + 100)
    signed.mav.signing.allow_unsigned_callback = lambda *_: True  # to hear that no answer comes
    assert not answered(signed)
    assert counted(signed, "bad signature") == 1


def test_any_changed_byte_is_refused(signed):
    """Also with the checksum put right again: a forger can do that."""
    raw = bytearray(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0).pack(signed.mav))
    for place in (4, 10, len(raw) - 13, len(raw) - 9, len(raw) - 1):
        forged = bytearray(raw)
        forged[place] ^= 1
        crc = mavlink.x25crc(bytes(forged[1:-15]) + bytes((152,))).crc
        forged[-15:-13] = crc.to_bytes(2, "little")
        signed.udp.sendto(bytes(forged), signed.to)
    signed.fly(0.1)
    assert counted(signed, "bad signature") == 5
    assert not signed.commander.armed
    signed.udp.sendto(bytes(raw), signed.to)
    signed.fly(0.1)
    assert signed.commander.armed, "a forged timestamp of the future did not make the true one old"


def test_a_replayed_frame_is_refused(signed):
    raw = mavlink.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0).pack(signed.mav)
    for _ in range(3):
        signed.udp.sendto(raw, signed.to)
    signed.fly(0.2)
    assert counted(signed, "replayed") == 2
    assert sum(m.get_type() == "AUTOPILOT_VERSION" for m in signed.messages) == 1


def test_a_new_sender_may_be_a_minute_late_and_no_more(signed):
    signed.send(HEARTBEAT)
    signed.fly(0.1)
    ours = signed.link.signing._timestamp
    for late, link_id, refused in ((NEW_STREAM_LATE_MAX - 10_000, 8, 0), (NEW_STREAM_LATE_MAX + 10_000, 9, 1)):
        sign_with_pymavlink(signed, KEY, ours - late, link_id)
        signed.send(HEARTBEAT)
        signed.fly(0.05)
        assert counted(signed, "replayed") == refused


def test_senders_are_told_apart_by_link(signed):
    """Two links of one ground station need not agree about the time."""
    signed.send(HEARTBEAT)
    sign_with_pymavlink(signed, KEY, NOW + 5, link_id=4)
    signed.send(HEARTBEAT)
    signed.fly(0.1)
    assert counted(signed, "replayed") == 0
    assert counted(signed, "unsigned") == 0


def test_a_key_is_refused_while_armed(vehicle):
    """AUTOPILOT.md 6: "refuse SETUP_SIGNING while armed"."""
    vehicle.take_off(495.0)
    set_up(vehicle)
    assert counted(vehicle, "key refused") == 1
    assert answered(vehicle)
    assert "Signing key refused: armed" in vehicle.texts()


def test_a_key_for_everybody_is_refused(vehicle):
    vehicle.boot()
    set_up(vehicle, system=0)
    assert counted(vehicle, "key refused") == 1
    assert answered(vehicle)


def test_a_timestamp_of_more_than_48_bits_is_refused(vehicle):
    """It would not fit a signature."""
    vehicle.boot()
    set_up(vehicle, timestamp=2**48)
    assert counted(vehicle, "key refused") == 1
    assert answered(vehicle)
    set_up(vehicle, timestamp=2**48 - 1)  # the last one: ours begin anew after it
    assert int.from_bytes(vehicle.link.signing.sign(b"", 0)[1:7], "little") < 1000


def test_a_key_is_changed_and_ended_only_by_who_has_it(signed):
    signed.mav.signing.sign_outgoing = False
    set_up(signed, bytes(32), 0)
    assert counted(signed, "unsigned") == 1
    signed.mav.signing.sign_outgoing = True
    signed.mav.signing.timestamp += 1000
    other = bytes(range(32))
    signed.mav.signing.allow_unsigned_callback = lambda *_: True
    set_up(signed, other, NOW)
    sign_with_pymavlink(signed, other, NOW + 1_000_000)
    assert answered(signed)
    signed.mav.signing.allow_unsigned_callback = lambda *_: True
    set_up(signed, bytes(32), 0)
    signed.mav.signing.sign_outgoing = False
    assert answered(signed)


def test_the_ground_link_has_the_same_key(signed):
    """And a timestamp is used once on all links together."""
    stamps = [signed.link.signing.sign(b"", link_id)[1:7] for link_id in (0, 1, 0, 1)]
    assert sorted(stamps) == stamps
    assert len(set(stamps)) == 4


@given(st.integers(1, 2**48 - 1), st.integers(0, 255), st.binary(min_size=32, max_size=32))
def test_signatures_equal_pymavlinks(timestamp, link_id, key):
    mav = mavlink.MAVLink(None, srcSystem=9, srcComponent=1)
    mav.signing.secret_key, mav.signing.link_id, mav.signing.sign_outgoing = key, link_id, True
    mav.signing.timestamp = timestamp
    expected = mavlink.MAVLink_heartbeat_message(2, 12, 0, 7, 3, 3).pack(mav)
    ours = Signing(key)
    ours.tick(EPOCH_2015_US + 10 * (timestamp - 1))
    payload = pack("HEARTBEAT", type=2, autopilot=12, base_mode=0, custom_mode=7, system_status=3, mavlink_version=3)
    signed = ours.sign(frame(payload, 0, 9, 1, SIGNED), link_id)
    assert signed == expected
    good, rest = split(signed, Counter())
    assert not rest
    assert isinstance(good[0], Frame)
    assert Signing(key).refusal(good[0]) == ""


@pytest.mark.parametrize(
    "content", [b"", b"short", bytes(33), b"zz" * 32, "ä".encode() * 32], ids=["empty", "short", "33", "not hex", "ä"]
)
def test_a_bad_key_file_is_one_clear_line(tmp_path: Path, content: bytes):
    path = tmp_path / "key"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"key: \d+ bytes are neither a key of 32 bytes nor 64 hexadecimal digits"):
        read_key(path)
    with pytest.raises(ValueError, match="nowhere: cannot be read"):
        read_key(tmp_path / "nowhere")


@pytest.mark.parametrize("text", [False, True])
def test_a_key_file_signs_from_the_start(tmp_path: Path, text: bool):
    path = tmp_path / "key"
    path.write_bytes(KEY.hex().encode() + b"\n" if text else KEY)
    with sitl_process("--signing-key", str(path)) as sitl, lockstep(sitl) as client:
        client.mav.signing.secret_key, client.mav.signing.sign_outgoing = KEY, True
        client.mav.signing.timestamp = NOW
        client.send(HEARTBEAT)  # tells the vehicle the time: in lockstep its own clock starts with 2026
        client.fly(2)
        assert client.mav.signing.badsig_count == 0
        assert client.latest["HEARTBEAT"].get_signed()
        assert client.command(512, 148) == 0
