"""MAVLink 2 message signing: who may speak, proven by a shared key (mavlink.io, "Message Signing").

One per vehicle, for all its links. Time is vehicle time in units of 10 us since 2015-01-01.
"""

import hashlib
from pathlib import Path

from sitl.links.frames import Frame

EPOCH_2015_US = 1_420_070_400_000_000
"""Unix time of 2015-01-01 [us]."""
NEW_STREAM_LATE_MAX = 6_000_000
"""A sender not heard before may be one minute behind our clock, no more."""
TIMESTAMP_MAX = 2**48 - 1
KEY_BYTES = 32
SETUP_SIGNING = 256
RADIO_STATUS, ADSB_VEHICLE, COLLISION = 109, 246, 247
UNSIGNED_ACCEPTED = frozenset({RADIO_STATUS, ADSB_VEHICLE, COLLISION})
"""Messages that need no signature: their senders have no key, and they command nothing (PX4's list)."""


class Signing:
    """The key, our timestamp, and the newest timestamp of every sender."""

    def __init__(self, key: bytes | None = None) -> None:
        """Without a key everything is accepted and nothing is signed."""
        self._key = key
        self._timestamp = 0
        self._streams: dict[tuple[int, int, int], int] = {}
        self._links = 0

    def new_link_id(self) -> int:
        """A number for one more link."""
        self._links += 1
        return self._links - 1 & 0xFF

    @property
    def active(self) -> bool:
        return self._key is not None

    def set_up(self, key: bytes, timestamp: int) -> None:
        """SETUP_SIGNING: from now on with this key; a key and a timestamp of zeros end signing. Raises ValueError."""
        if len(key) != KEY_BYTES:
            raise ValueError(f"signing key: {len(key)} bytes are not {KEY_BYTES}")
        if timestamp > TIMESTAMP_MAX:
            raise ValueError(f"signing timestamp: {timestamp} is more than {TIMESTAMP_MAX}")
        self._key = key if timestamp or any(key) else None
        self._timestamp = max(self._timestamp, timestamp)
        self._streams.clear()

    def tick(self, unix_us: int) -> None:
        """Our clock, which never goes back."""
        self._timestamp = max(self._timestamp, (unix_us - EPOCH_2015_US) // 10)

    def sign(self, unsigned: bytes, link_id: int) -> bytes:
        """The frame with its signature; every signature has a timestamp of its own."""
        self._timestamp = self._timestamp + 1 & TIMESTAMP_MAX
        stamped = unsigned + bytes((link_id,)) + self._timestamp.to_bytes(6, "little")
        return stamped + self._signature(stamped)

    def refusal(self, received: Frame) -> str:
        """Why a frame is not to be believed: `unsigned`, `bad signature`, `replayed`; empty when it is.

        The signature is checked first, so that a forged frame cannot move a sender's timestamp.
        """
        if self._key is None:
            return ""
        if not received.signed:
            return "" if received.message_id in UNSIGNED_ACCEPTED else "unsigned"
        stamped, signature = received.raw[:-6], received.raw[-6:]
        if self._signature(stamped) != signature:
            return "bad signature"
        stream = (received.system, received.component, stamped[-7])
        timestamp = int.from_bytes(stamped[-6:], "little")
        newest = self._streams.get(stream)
        if timestamp + NEW_STREAM_LATE_MAX < self._timestamp if newest is None else timestamp <= newest:
            return "replayed"
        self._streams[stream] = timestamp
        self._timestamp = max(self._timestamp, timestamp)
        return ""

    def _signature(self, stamped: bytes) -> bytes:
        assert self._key is not None
        return hashlib.sha256(self._key + stamped).digest()[:6]


def read_key(path: Path) -> bytes:
    """A key file: 32 bytes, or 64 hexadecimal digits. Raises ValueError with the reason."""
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
