"""MAVLink 2 message signing (mavlink.io, "Message Signing"): who may be believed, proven by a shared key."""

import hashlib
import hmac
import time
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

KEY_BYTES = 32
EPOCH_2015_US = 1_420_070_400_000_000
"""Unix time of 2015-01-01 [us], where timestamps of signatures begin; they count 10 us."""
LATE_MAX = 6_000_000
"""A sender not heard before may be a minute behind our clock, no more."""


class Signing:
    """The key, and the newest timestamp of every sender heard.

    `wall_clock`: the other end's clock is the world's, so that what is more than a minute old is a replay. A simulator
    in lockstep has a time of its own.
    """

    def __init__(self, key: bytes, wall_clock: bool = True) -> None:
        self._key = key
        self._newest = timestamp() if wall_clock else 0
        self._streams: dict[tuple[int, int, int], int] = {}
        self._codecs: list[Any] = []

    def sign_what(self, codec: Any) -> None:  # noqa: ANN401  pymavlink has no types
        """Let `codec` sign all it packs, at a time that is never before what was heard.

        A companion computer without a clock of its own starts years late: the autopilot, which has GPS time, would take
        its frames for old ones.
        """
        codec.signing.secret_key = self._key
        codec.signing.timestamp = timestamp()
        codec.signing.sign_outgoing = True
        self._codecs.append(codec)

    def refusal(self, frame: bytes) -> str:
        """Why a frame is not to be believed: `unsigned`, `bad_signature`, `replayed`; empty when it is.

        The signature is judged first, so that a forged frame cannot move a sender's timestamp.
        """
        if not is_signed(frame):
            return "unsigned"
        if not hmac.compare_digest(hashlib.sha256(self._key + frame[:-6]).digest()[:6], frame[-6:]):
            return "bad_signature"
        stream, stamp = (frame[5], frame[6], frame[-13]), int.from_bytes(frame[-12:-6], "little")
        before = self._streams.get(stream)
        if stamp + LATE_MAX < self._newest if before is None else stamp <= before:
            return "replayed"
        self._streams[stream] = stamp
        self._newest = max(self._newest, stamp)
        for codec in self._codecs:
            codec.signing.timestamp = max(codec.signing.timestamp, stamp)
        return ""


def is_signed(frame: bytes) -> bool:
    """Whether a whole frame carries a signature."""
    return frame[0] == mavlink.PROTOCOL_MARKER_V2 and bool(frame[2] & mavlink.MAVLINK_IFLAG_SIGNED)


def read_key(path: Path) -> bytes:
    """A key file: 32 bytes, or 64 hexadecimal digits. Raises ValueError with the reason, never with the content."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None
    if len(content) == KEY_BYTES:
        return content
    try:
        key = bytes.fromhex(content.decode("ascii"))
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise ValueError(f"{path}: {len(content)} bytes are neither a key of 32 bytes nor 64 hexadecimal digits")
    return key


def timestamp() -> int:
    """Now. Taken from the clock at every start, so that no two flights use one twice."""
    return (time.time_ns() // 1000 - EPOCH_2015_US) // 10
