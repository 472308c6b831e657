"""How many bytes a source address may have read: spent before a byte of them is parsed, refilled with vehicle time."""

BYTES_PER_MS = 400
"""400 kB per second of vehicle time: four times a 921600 baud telemetry radio."""
BURST = 1 << 16
"""Bytes that may come at once, e.g. a mission or the parameters of a whole vehicle."""
PACKET_OVERHEAD = 28
"""What a datagram costs besides its content (IP and UDP headers), so that empty ones are not free."""


class Budget:
    """A token bucket on vehicle time."""

    def __init__(self, now_ms: int) -> None:
        self._left = BURST
        self._since_ms = now_ms

    def left(self, now_ms: int) -> int:
        """Bytes that may still be read now."""
        self._left = min(BURST, self._left + (now_ms - self._since_ms) * BYTES_PER_MS)
        self._since_ms = now_ms
        return self._left

    def take(self, size: int, now_ms: int) -> bool:
        """Whether so many bytes may be read now; if so they are spent."""
        if size > self.left(now_ms):
            return False
        self._left -= size
        return True
