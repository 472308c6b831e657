"""Topics: which message goes where, how it is kept, and how bad payloads are refused.

Key expressions are `star/<vehicle>/<topic>`; see `docs/architecture.md` for who publishes what.
"""

import re
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import msgspec
import zenoh
import zenoh.ext

from bus import messages as m

M = TypeVar("M", bound=m.Message)

VEHICLE_NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")
COMMAND = "command"
ALIVE = "alive"


@dataclass(frozen=True)
class Topic(Generic[M]):
    """A typed channel. `cached` topics replay their last message to late joiners."""

    name: str
    message: type[M]
    cached: bool = False
    newest_only: bool = False

    @property
    def encoding(self) -> zenoh.Encoding:
        return encoding(self.message)


STATE = Topic("state", m.VehicleState, newest_only=True)
SLOT = Topic("slot", m.SlotOpened, cached=True)
CSI = Topic("rf/csi", m.ChannelState, cached=True)
ACTION = Topic("agent/action", m.Action)
SETPOINT = Topic("setpoint", m.Setpoint)
CONFIGURATION = Topic("ris/configuration", m.RisConfiguration, cached=True)
LINK = Topic("rf/link", m.LinkReport, cached=True)
EVENT = Topic("event", m.MissionEvent)
HEALTH = Topic("health", m.NodeHealth)

TOPICS: tuple[Topic[Any], ...] = (STATE, SLOT, CSI, ACTION, SETPOINT, CONFIGURATION, LINK, EVENT, HEALTH)


class Declared(Protocol):
    """Something held open on a session for as long as it is wanted."""

    def undeclare(self) -> None: ...


class RefusedError(ValueError):
    """A payload that is not the message it should be; the text names the field."""


def key(vehicle: str, name: str) -> str:
    """Key expression of a topic (or `command`, or `alive/<node>`) of one vehicle.

    Raises ValueError when `vehicle` is not 1 to 32 letters, digits, `_` or `-`.
    """
    if not VEHICLE_NAME.fullmatch(vehicle):
        raise ValueError(f"vehicle: {vehicle!r} is not a name of 1 to 32 letters, digits, '_' or '-'")
    return f"star/{vehicle}/{name}"


def encoding(message: type[m.Message]) -> zenoh.Encoding:
    """`application/json;aerialstar.<Message>.v1`."""
    return zenoh.Encoding.APPLICATION_JSON.with_schema(f"aerialstar.{message.__name__}.v1")


def encode(message: m.Message) -> bytes:
    """Wire form. Non-finite numbers would become null, which every reader refuses."""
    return msgspec.json.encode(message)


def decode(payload: bytes, message: type[M]) -> M:
    """Read a wire form strictly. Raises RefusedError."""
    try:
        return msgspec.json.decode(payload, type=message)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise RefusedError(f"{message.__name__}: {error}") from error


class Publisher(Generic[M]):
    """Sends one topic of one vehicle; reliable, blocking rather than dropping (`newest_only` topics may drop)."""

    def __init__(self, session: zenoh.Session, vehicle: str, topic: Topic[M]) -> None:
        congestion = zenoh.CongestionControl.DROP if topic.newest_only else zenoh.CongestionControl.BLOCK
        keyexpr = key(vehicle, topic.name)
        if topic.cached:
            self._publisher: zenoh.Publisher | zenoh.ext.AdvancedPublisher = zenoh.ext.declare_advanced_publisher(
                session,
                keyexpr,
                encoding=topic.encoding,
                congestion_control=congestion,
                reliability=zenoh.Reliability.RELIABLE,
                cache=zenoh.ext.CacheConfig(1),
                publisher_detection=True,
            )
        else:
            self._publisher = session.declare_publisher(
                keyexpr,
                encoding=topic.encoding,
                congestion_control=congestion,
                reliability=zenoh.Reliability.RELIABLE,
            )

    def send(self, message: M) -> None:
        self._publisher.put(encode(message))


def subscribe(
    session: zenoh.Session,
    vehicle: str,
    topic: Topic[M],
    receive: Callable[[M], None],
    refused: Counter[str],
) -> Declared:
    """Call `receive` with every good message of a topic, in order, on zenoh's thread.

    Bad payloads are counted in `refused[topic.name]` and go no further. `cached` topics deliver the last message
    sent before this call. Keep the returned subscriber for as long as messages are wanted.
    """

    def on_sample(sample: zenoh.Sample) -> None:
        try:
            message = decode(sample.payload.to_bytes(), topic.message)
        except RefusedError:
            refused[topic.name] += 1
            return
        receive(message)

    keyexpr = key(vehicle, topic.name)
    if topic.cached:
        return zenoh.ext.declare_advanced_subscriber(
            session,
            keyexpr,
            on_sample,
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
        )
    return session.declare_subscriber(keyexpr, on_sample)


def send_command(session: zenoh.Session, vehicle: str, command: m.Command, timeout_s: float = 5.0) -> m.CommandReply:
    """Ask the bridge for something and return its answer. Raises TimeoutError when nobody answers."""
    keyexpr = key(vehicle, COMMAND)
    replies = session.get(keyexpr, payload=encode(command), encoding=encoding(m.Command), timeout=timeout_s)
    for reply in replies:
        if reply.ok is not None:
            return decode(reply.ok.payload.to_bytes(), m.CommandReply)
    raise TimeoutError(f"command {command.name}: no answer on {keyexpr} within {timeout_s:g} s")


def answer_commands(
    session: zenoh.Session,
    vehicle: str,
    answer: Callable[[m.Command], m.CommandReply],
    refused: Counter[str],
) -> Declared:
    """Serve the command queryable; `answer` runs on zenoh's thread and must not block for long."""
    keyexpr = key(vehicle, COMMAND)

    def on_query(query: zenoh.Query) -> None:
        with query:
            try:
                payload = query.payload.to_bytes() if query.payload is not None else b""
                reply = answer(decode(payload, m.Command))
            except RefusedError as error:
                refused[COMMAND] += 1
                reply = m.CommandReply(accepted=False, reason=str(error))
            query.reply(keyexpr, encode(reply), encoding=encoding(m.CommandReply))

    return session.declare_queryable(keyexpr, on_query)


def declare_alive(session: zenoh.Session, vehicle: str, node: str) -> Declared:
    """Liveliness token of a node; it drops when the process dies."""
    return session.liveliness().declare_token(key(vehicle, f"{ALIVE}/{node}"))


def watch_alive(session: zenoh.Session, vehicle: str, changed: Callable[[str, bool], None]) -> Declared:
    """Call `changed(node, alive)` when nodes come (those already there included) and go."""

    def on_sample(sample: zenoh.Sample) -> None:
        changed(str(sample.key_expr).rsplit("/", 1)[-1], sample.kind == zenoh.SampleKind.PUT)

    return session.liveliness().declare_subscriber(key(vehicle, f"{ALIVE}/*"), on_sample, history=True)


def watch_end(session: zenoh.Session, vehicle: str, ended: Callable[[], None]) -> list[Declared]:
    """Call `ended` when the flight is over: the bridge says so or is gone, or the mission went before a bridge came.

    It may be called more than once, on zenoh's thread.
    """
    bridge_seen = False

    def on_event(event: m.MissionEvent) -> None:
        if event.kind == "ended":
            ended()

    def on_alive(node: str, alive: bool) -> None:
        nonlocal bridge_seen
        bridge_seen |= node == "bridge"
        if not alive and (node == "bridge" or (node == "mission" and not bridge_seen)):
            ended()

    return [subscribe(session, vehicle, EVENT, on_event, Counter()), watch_alive(session, vehicle, on_alive)]


def health(node: str, counters: Mapping[str, int], refused: Mapping[str, int]) -> m.NodeHealth:
    """A node's counters now, with the bad payloads it refused by topic."""
    counted = {**counters, **{f"refused {topic}": count for topic, count in refused.items()}}
    return m.NodeHealth(node=node, wall_time_s=time.time(), counters=counted)
