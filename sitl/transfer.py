"""The mission protocol as a state machine: pure functions of state and event, on vehicle time.

One transfer runs at a time, whoever asks (https://mavlink.io/en/services/mission.html). Each function returns the
next state and what is to be done: frames for a client, texts for all, a plan to store. Nothing here is stored or sent.
"""

from dataclasses import dataclass, replace
from typing import TypeAlias

from sitl.links.link import Link
from sitl.plan import Item, Kind, Verdict, judge, judge_whole


@dataclass(frozen=True)
class Rules:
    """How an autopilot transfers plans."""

    capacity: tuple[int, int]
    """Most items of a mission and of a fence."""
    retry_ms: int
    """An item that does not come is asked for again after so long."""
    timeout_ms: int
    """A silent client is given up after so long."""
    busy: Verdict
    """What the client of a second transfer is told."""


@dataclass(frozen=True)
class Client:
    """Who transfers: a MAVLink component on a link."""

    link: Link
    system: int
    component: int


@dataclass(frozen=True)
class Idle:
    """No transfer."""


@dataclass(frozen=True)
class Upload:
    """Items are asked for one by one."""

    client: Client
    kind: Kind
    count: int
    items: tuple[Item, ...]
    heard_ms: int
    asked_ms: int
    integer: bool = True
    """Whether the client speaks MISSION_ITEM_INT; it is believed by what it sends."""


@dataclass(frozen=True)
class Download:
    """Items are given as they are asked for."""

    client: Client
    kind: Kind
    items: tuple[Item, ...]
    heard_ms: int


Transfer: TypeAlias = Idle | Upload | Download


@dataclass(frozen=True)
class Ask:
    """MISSION_REQUEST_INT, or MISSION_REQUEST for a client of floats."""

    client: Client
    kind: Kind
    seq: int
    integer: bool


@dataclass(frozen=True)
class Ack:
    """MISSION_ACK."""

    client: Client
    kind: int
    verdict: Verdict


@dataclass(frozen=True)
class Count:
    """MISSION_COUNT."""

    client: Client
    kind: int
    count: int


@dataclass(frozen=True)
class Give:
    """MISSION_ITEM_INT, or MISSION_ITEM."""

    client: Client
    kind: Kind
    seq: int
    item: Item
    integer: bool


@dataclass(frozen=True)
class Say:
    """STATUSTEXT, critical."""

    text: str


@dataclass(frozen=True)
class Store:
    """The vehicle's plan of this kind from now on."""

    kind: Kind
    items: tuple[Item, ...]


Deed: TypeAlias = Ask | Ack | Count | Give | Say | Store
Step: TypeAlias = tuple[Transfer, tuple[Deed, ...]]

IDLE = Idle()


@dataclass
class Exchange:
    """What the mission service of one vehicle remembers."""

    transfer: Transfer = IDLE
    told_current: int = 0
    """The item that clients were last told is flown."""


def _ask(upload: Upload) -> Ask:
    return Ask(upload.client, upload.kind, len(upload.items), upload.integer)


def _stored(kind: int) -> Kind | None:
    """The kinds of plan that are kept; rally points are not."""
    return Kind(kind) if kind in (Kind.MISSION, Kind.FENCE) else None


def _busy(transfer: Transfer, client: Client, kind: int, text: str, rules: Rules) -> Step:
    texts = (Say(text),) if rules.busy is Verdict.ERROR else ()
    return transfer, (*texts, Ack(client, kind, rules.busy))


def on_count(transfer: Transfer, client: Client, kind: int, count: int, now_ms: int, rules: Rules) -> Step:
    """MISSION_COUNT: a client wants to upload so many items; none clears the plan."""
    if isinstance(transfer, Upload) and (transfer.client != client or transfer.items):
        return _busy(transfer, client, kind, "WPM: REJ. CMD: Busy", rules)
    if isinstance(transfer, Download) and transfer.client != client:
        return _busy(transfer, client, kind, "WPM: IGN MISSION_COUNT: Busy", rules)
    known = _stored(kind)
    if known is None:
        return IDLE, (Ack(client, kind, Verdict.ACCEPTED if count == 0 else Verdict.UNSUPPORTED),)
    if count == 0:
        return IDLE, (Store(known, ()), Ack(client, kind, Verdict.ACCEPTED))
    if count > rules.capacity[known]:
        return IDLE, (Ack(client, kind, Verdict.NO_SPACE),)
    upload = Upload(client, known, count, (), now_ms, now_ms)
    return upload, (_ask(upload),)


def on_item(
    transfer: Transfer, client: Client, kind: int, seq: int, item: Item, integer: bool, now_ms: int, rules: Rules
) -> Step:
    """MISSION_ITEM_INT or MISSION_ITEM (`integer` False): the next item of an upload."""
    if not isinstance(transfer, Upload):
        return transfer, (Ack(client, kind, Verdict.ERROR),)
    if transfer.client != client:
        return _busy(transfer, client, kind, "IGN MISSION_ITEM: Busy", rules)
    if transfer.kind != kind:
        return IDLE, (Ack(client, kind, Verdict.ERROR),)
    if seq >= transfer.count:
        return IDLE, (Ack(client, kind, Verdict.INVALID_SEQUENCE),)
    expected = len(transfer.items)
    upload = replace(transfer, heard_ms=now_ms, asked_ms=now_ms, integer=integer)
    if seq < expected:  # a repetition of what is there already
        return upload, ()
    if seq > expected:
        return upload, (_ask(upload),)
    verdict = judge(item, transfer.kind)
    if verdict is not Verdict.ACCEPTED:
        return IDLE, (Ack(client, kind, verdict),)
    upload = replace(upload, items=(*transfer.items, item))
    if len(upload.items) < upload.count:
        return upload, (_ask(upload),)
    verdict = judge_whole(upload.items, upload.kind)
    if verdict is not Verdict.ACCEPTED:
        return IDLE, (Ack(client, kind, verdict),)
    return IDLE, (Store(upload.kind, upload.items), Ack(client, kind, Verdict.ACCEPTED))


def on_list(transfer: Transfer, client: Client, kind: int, items: tuple[Item, ...], now_ms: int, rules: Rules) -> Step:
    """MISSION_REQUEST_LIST: a client wants the plan, which is `items`."""
    if not isinstance(transfer, Idle) and transfer.client != client:
        return _busy(transfer, client, kind, "IGN REQUEST LIST: Busy", rules)
    known = _stored(kind)
    if known is None or not items:
        return IDLE, (Count(client, kind, 0),)
    return Download(client, known, items, now_ms), (Count(client, kind, len(items)),)


def on_request(transfer: Transfer, client: Client, kind: int, seq: int, integer: bool, now_ms: int) -> Step:
    """MISSION_REQUEST_INT or MISSION_REQUEST: give an item. Outside a download it is not answered, as by PX4."""
    if not isinstance(transfer, Download) or transfer.client != client:
        return transfer, ()
    if kind != transfer.kind or not seq < len(transfer.items):
        return IDLE, (Ack(client, kind, Verdict.INVALID_SEQUENCE),)
    return replace(transfer, heard_ms=now_ms), (Give(client, transfer.kind, seq, transfer.items[seq], integer),)


def on_ack(transfer: Transfer, client: Client) -> Step:
    """MISSION_ACK: the client has all it wanted, or gives up."""
    if not isinstance(transfer, Idle) and transfer.client == client:
        return IDLE, ()
    return transfer, ()


def on_clear(transfer: Transfer, client: Client, kind: int, rules: Rules) -> Step:
    """MISSION_CLEAR_ALL: forget the plan of a kind, or of all kinds (255)."""
    if not isinstance(transfer, Idle) and transfer.client != client:
        return _busy(transfer, client, kind, "WPM: IGN CLEAR CMD: Busy", rules)
    kinds = (Kind.MISSION, Kind.FENCE) if kind == 255 else tuple(k for k in (_stored(kind),) if k is not None)
    return IDLE, (*(Store(k, ()) for k in kinds), Ack(client, kind, Verdict.ACCEPTED))


def on_time(transfer: Transfer, now_ms: int, rules: Rules) -> Step:
    """Time passes: ask again for what did not come, give up a client that vanished."""
    if isinstance(transfer, Idle):
        return transfer, ()
    if now_ms - transfer.heard_ms >= rules.timeout_ms:
        if isinstance(transfer, Download):
            return IDLE, ()
        return IDLE, (Say("Operation timeout"), Ack(transfer.client, transfer.kind, Verdict.OPERATION_CANCELLED))
    if isinstance(transfer, Upload) and now_ms - transfer.asked_ms >= rules.retry_ms:
        upload = replace(transfer, asked_ms=now_ms)
        return upload, (_ask(upload),)
    return transfer, ()
