"""Where an autopilot is: the URLs that `link` can open."""

import re
from dataclasses import dataclass
from typing import Literal
from urllib.parse import urlsplit

ALLOWED = "udpin://HOST:PORT, udpout://HOST:PORT, tcp://HOST:PORT or serial://DEVICE:BAUD"
EXAMPLE = "e.g. udpin://127.0.0.1:14540"


@dataclass(frozen=True)
class Udp:
    """A UDP socket: `udpin` listens there and answers whom it hears, `udpout` speaks first to there."""

    scheme: Literal["udpin", "udpout"]
    host: str
    port: int


@dataclass(frozen=True)
class Tcp:
    """A TCP connection to there."""

    host: str
    port: int


@dataclass(frozen=True)
class Serial:
    """A serial line, 8N1."""

    device: str
    baud: int


Address = Udp | Tcp | Serial


def parse_url(url: str) -> Address:
    """What `url` means. Raises ValueError with what is allowed."""
    scheme, _, rest = url.partition("://")
    if scheme == "serial":
        return _serial(url, rest)
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise ValueError(f"{url!r}: {error}") from None
    if parts.path or parts.query or parts.fragment or parts.username or not host or port is None:
        raise ValueError(f"{url!r}: must be {ALLOWED}, {EXAMPLE}")
    if port == 0 and scheme != "udpin":
        raise ValueError(f"{url!r}: port 0 can only be listened on (udpin)")
    match scheme:
        case "udpin" | "udpout":
            return Udp(scheme, host, port)
        case "tcp":
            return Tcp(host, port)
    raise ValueError(f"{url!r}: must be {ALLOWED}, {EXAMPLE}")


def _serial(url: str, rest: str) -> Serial:
    match = re.fullmatch(r"(\S+):(\d+)", rest)
    if match is None or int(match[2]) == 0:
        raise ValueError(f"{url!r}: must be serial://DEVICE:BAUD, e.g. serial:///dev/ttyACM0:57600")
    return Serial(match[1], int(match[2]))
