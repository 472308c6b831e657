"""MAVLink 2 signing, against pymavlink's own signatures and against a SITL that believes nothing else."""

import hashlib
import os
import socket

import pytest
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.clock import Lockstep
from autopilot_bridge.dialects.known import dialects
from autopilot_bridge.link import Link
from autopilot_bridge.pymavlink_vehicle import PymavlinkVehicle
from autopilot_bridge.signing import LATE_MAX, Signing, read_key, timestamp
from autopilot_bridge.vehicle import SilentError, VehicleError

KEY = hashlib.sha256(b"correct horse").digest()
WRONG = hashlib.sha256(b"battery staple").digest()


def signed(key=KEY, stamp=None, link_id=0):
    """A frame signed by pymavlink."""
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    codec.signing.secret_key, codec.signing.sign_outgoing = key, True
    codec.signing.timestamp = timestamp() if stamp is None else stamp
    codec.signing.link_id = link_id
    return bytes(mavlink.MAVLink_attitude_message(1, 0.1, 0.2, 0.3, 0, 0, 0).pack(codec))


def test_what_is_believed():
    now = timestamp()
    ours = Signing(KEY)
    unsigned = mavlink.MAVLink_attitude_message(1, 0, 0, 0, 0, 0, 0).pack(mavlink.MAVLink(None, 1, 1))
    assert ours.refusal(bytes(unsigned)) == "unsigned"
    assert ours.refusal(signed(WRONG, now + 10**6)) == "bad_signature"
    first = signed(stamp=now)
    assert ours.refusal(first) == ""  # the forged one before has not moved the sender's time
    assert ours.refusal(first) == "replayed"
    assert ours.refusal(signed(stamp=now + 5)) == ""
    assert ours.refusal(signed(stamp=now + 1)) == "replayed"
    assert ours.refusal(signed(stamp=now + 1, link_id=3)) == ""  # another link's time is its own
    assert ours.refusal(signed(stamp=now - LATE_MAX - 10**5, link_id=4)) == "replayed"


def test_a_companion_whose_clock_starts_years_late_signs_by_the_autopilots(monkeypatch):
    now = timestamp()
    monkeypatch.setattr("autopilot_bridge.signing.timestamp", lambda: 1000)
    ours, codec = Signing(KEY), mavlink.MAVLink(None, srcSystem=245, srcComponent=191)
    ours.sign_what(codec)

    def stamped():
        frame = bytes(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(codec))
        return int.from_bytes(frame[-12:-6], "little")

    assert stamped() < 2000
    assert ours.refusal(signed(stamp=now)) == ""
    first = stamped()
    assert now <= first < now + 10
    assert ours.refusal(signed(WRONG, now + 10**9)) == "bad_signature"  # forged: moves nothing
    assert first < stamped() < now + 10


@pytest.mark.parametrize("bit", [10 * 8, 20 * 8 + 3, -1])
def test_a_single_bit_is_seen(bit):
    frame = bytearray(signed())
    frame[bit // 8 if bit >= 0 else -1] ^= 1 << bit % 8
    assert Signing(KEY).refusal(bytes(frame)) == "bad_signature"


def test_key_files(tmp_path):
    path = tmp_path / "key"
    path.write_bytes(KEY)
    assert read_key(path) == KEY
    path.write_text(KEY.hex() + "\n")
    assert read_key(path) == KEY
    path.write_text("secret words")
    with pytest.raises(ValueError, match="12 bytes are neither a key of 32 bytes nor 64 hex") as told:
        read_key(path)
    assert "secret" not in str(told.value)
    with pytest.raises(ValueError, match=r"cannot be read.*No such file"):
        read_key(tmp_path / "missing")


@pytest.fixture
def connect(sitl, tmp_path, monkeypatch):
    """Connects to a SITL that has `KEY`, with what key you give."""
    monkeypatch.setattr("autopilot_bridge.mavlink_vehicle.CONNECT_WALL_S", 1.0)
    opened = []

    def start(key, sitl_key=KEY):
        path = tmp_path / "sitl.key"
        path.write_bytes(sitl_key or b"")
        autopilot = sitl("--lockstep", *(("--signing-key", str(path)) if sitl_key else ()))
        signing = None if key is None else Signing(key, wall_clock=False)
        link = Link(f"udpin://127.0.0.1:{autopilot.port}", 1, tmp_path / "flight.tlog", signing=signing)
        clock = Lockstep(autopilot.control, 50)
        vehicle = PymavlinkVehicle(link, dialects("auto"), 1, clock, lambda: clock.step(vehicle))
        opened.append((clock, vehicle))
        vehicle.connect()
        return vehicle

    yield start
    for clock, vehicle in opened:
        clock.close(over=True)
        vehicle.close()


def test_flies_an_autopilot_that_demands_signatures(connect):
    vehicle = connect(KEY)
    vehicle.await_armable()
    vehicle.arm()
    assert vehicle.telemetry.armed
    assert vehicle.counters["unsigned"] == vehicle.counters["bad_signature"] == vehicle.counters["replayed"] == 0
    assert vehicle.counters["signed"] == vehicle.heard > 100


def test_a_wrong_key_is_told(connect):
    with pytest.raises(SilentError, match=r"never answered.*frames are signed with another key than signing_key's"):
        connect(WRONG)


def test_a_key_that_is_missing_is_told(connect):
    with pytest.raises(VehicleError, match=r"signs its frames .*: give its key as signing_key"):
        connect(None)


def test_what_others_do_not_sign_is_not_the_autopilots_fault():
    link = Link("udpin://127.0.0.1:0", 1, signing=Signing(KEY))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
        ground.sendto(beat.pack(mavlink.MAVLink(None, 255, 190)), ("127.0.0.1", link.port))
        assert link.receive(5.0) == []
    assert (link.counters["unsigned"], link.counters["foreign"]) == (0, 1)
    link.close()


def test_an_autopilot_that_does_not_sign_is_not_believed(connect):
    with pytest.raises(SilentError, match=r"never answered.*frames are not signed, as signing_key demands"):
        connect(os.urandom(32), sitl_key=None)
