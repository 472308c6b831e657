"""Opening a zenoh session with the defaults of the architecture.

Default: a peer on loopback only, multicast scouting off, gossip on, so that nodes that know one endpoint (the
launcher's) link up directly and the loop outlives that endpoint. Anything else (hosts, TLS, access control) comes
from a zenoh config file.
"""

import json
import re
import socket
from collections.abc import Sequence
from pathlib import Path

import zenoh


class BusError(RuntimeError):
    """The session could not be opened; the text says what was tried."""


def default_config(listen: str = "tcp/127.0.0.1:0", connect: Sequence[str] = ()) -> zenoh.Config:
    """Peer on loopback; `connect` are endpoints such as `tcp/127.0.0.1:7447`."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps("peer"))
    config.insert_json5("scouting/multicast/enabled", json.dumps(False))
    config.insert_json5("scouting/gossip/enabled", json.dumps(True))
    config.insert_json5("listen/endpoints", json.dumps([listen]))
    config.insert_json5("connect/endpoints", json.dumps(list(connect)))
    config.insert_json5("timestamping/enabled", json.dumps(True))  # AdvancedPublisher's cache orders by it
    config.insert_json5("connect/exit_on_failure", json.dumps(True))
    config.insert_json5("connect/timeout_ms", json.dumps(5000))
    return config


def open_session(
    config_file: Path | None = None,
    connect: Sequence[str] = (),
    listen: str = "tcp/127.0.0.1:0",
) -> zenoh.Session:
    """Open a session from a zenoh config file, or else with the defaults.

    Raises BusError when the file cannot be read or an endpoint is refused.
    """
    if config_file is not None:
        try:
            config = zenoh.Config.from_file(str(config_file))
        except zenoh.ZError as error:
            raise BusError(f"zenoh config {config_file}: {_why(error)}") from error
        tried = f"config {config_file}"
    else:
        config = default_config()
        tried = f"listen {listen}, connect {', '.join(connect) or 'nothing'}"
    try:
        if config_file is None:
            config.insert_json5("listen/endpoints", json.dumps([listen]))
        if connect:
            config.insert_json5("connect/endpoints", json.dumps(list(connect)))
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise BusError(f"zenoh endpoint refused ({tried}): {_why(error)}") from error


def _why(error: zenoh.ZError) -> str:
    """In one line, without the place in zenoh's source."""
    return re.sub(r" at /\S+\.rs:\d+\.?", "", " ".join(str(error).split()))


def free_endpoint() -> str:
    """A loopback endpoint whose port was free a moment ago (zenoh does not tell which port `:0` became)."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"
