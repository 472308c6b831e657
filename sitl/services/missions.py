"""The mission protocol on the wire: MISSION_* messages in and out of the state machine in `transfer.py`.

Progress goes to everybody: MISSION_ITEM_REACHED as items are done, MISSION_CURRENT as a stream and on every change.
"""

import math
from collections.abc import Iterable, Sequence

from sitl import transfer
from sitl.links.frames import Message, Payload, pack
from sitl.links.link import Link
from sitl.personality import CRITICAL, Result
from sitl.plan import WAYPOINT, Item, Kind, Verdict, judge, place
from sitl.targets import Destination
from sitl.transfer import IDLE, Ack, Ask, Client, Count, Deed, Give, Say, Step, Store
from sitl.vehicle import Vehicle

DEGREES = 1e-7
"""Of the integers in MISSION_ITEM_INT."""
INT32_MAX = 2**31 - 1
GUIDED = 2
"""MISSION_ITEM.current of a place to fly to now."""


def client(link: Link, message: Message) -> Client:
    return Client(link, message.get_srcSystem(), message.get_srcComponent())


def integer_degrees(value: float) -> int:
    """A float coordinate of MISSION_ITEM; NaN (left open) becomes 0, what is out of range stays so."""
    if math.isnan(value):
        return 0
    return round(min(max(value / DEGREES, -INT32_MAX), INT32_MAX))


def take(v: Vehicle, step: Step) -> None:
    """Remember the state of the transfer and do what is to be done."""
    v.exchange.transfer, deeds = step
    for deed in deeds:
        do(v, deed)


def do(v: Vehicle, deed: Deed) -> None:
    if isinstance(deed, Say):
        v.commander.say(deed.text, CRITICAL)
    elif isinstance(deed, Store):
        v.commander.plans.store(deed.kind, deed.items)
    else:
        deed.client.link.send(packed(v, deed))


def packed(v: Vehicle, deed: Ask | Ack | Count | Give) -> Payload:
    """The message of a deed."""
    target = {"target_system": deed.client.system, "target_component": deed.client.component}
    match deed:
        case Ask():
            name = "MISSION_REQUEST_INT" if deed.integer else "MISSION_REQUEST"
            return pack(name, **target, seq=deed.seq, mission_type=deed.kind)
        case Ack():
            return pack("MISSION_ACK", **target, type=int(deed.verdict), mission_type=deed.kind)
        case Count():
            return pack("MISSION_COUNT", **target, count=deed.count, mission_type=deed.kind)
        case Give():
            item, integer = deed.item, deed.integer
            return pack(
                "MISSION_ITEM_INT" if integer else "MISSION_ITEM",
                **target,
                seq=deed.seq,
                frame=shown_frame(item.frame, integer and v.personality.missions.integer_frames),
                command=item.command,
                current=int(deed.kind is Kind.MISSION and deed.seq == v.commander.plans.current),
                autocontinue=item.autocontinue,
                param1=item.p[0],
                param2=item.p[1],
                param3=item.p[2],
                param4=item.p[3],
                x=item.x if integer else item.x * DEGREES,
                y=item.y if integer else item.y * DEGREES,
                z=item.z,
                mission_type=deed.kind,
            )


def shown_frame(frame: int, integer: bool) -> int:
    """MAV_FRAME_GLOBAL and _RELATIVE_ALT have a twin for integer coordinates, of the same meaning."""
    return {0: 5, 3: 6}.get(frame, frame) if integer else {5: 0, 6: 3}.get(frame, frame)


def shown(v: Vehicle) -> tuple[Item, ...]:
    """The mission as it is downloaded: ArduPilot's item 0 is home, whatever was uploaded there."""
    mission = v.commander.plans.mission
    if not (v.personality.missions.home_first and mission):
        return mission
    home = v.commander.home or (0.0, 0.0, 0.0)
    latitude, longitude = v.origin.globe(home[0], home[1])
    at_home = (round(latitude / DEGREES), round(longitude / DEGREES), v.origin.altitude - home[2])
    return (Item(0, 16, (0.0, 0.0, 0.0, 0.0), *at_home), *mission[1:])


# Messages


def mission_count(v: Vehicle, link: Link, message: Message) -> None:
    rules = v.personality.missions.rules
    kind, count = message.mission_type, message.count
    take(v, transfer.on_count(v.exchange.transfer, client(link, message), kind, count, v.now_ms, rules))


def mission_item_int(v: Vehicle, link: Link, message: Message) -> None:
    _item(v, link, message, message.x, message.y, True)


def mission_item(v: Vehicle, link: Link, message: Message) -> None:
    _item(v, link, message, integer_degrees(message.x), integer_degrees(message.y), False)


def _item(v: Vehicle, link: Link, m: Message, x: int, y: int, integer: bool) -> None:
    p = (m.param1, m.param2, m.param3, m.param4)
    item = Item(m.frame, m.command, p, x, y, m.z, int(m.autocontinue))
    if m.current == GUIDED and v.personality.missions.home_first:
        take(v, (v.exchange.transfer, (Ack(client(link, m), m.mission_type, go_to(v, item)),)))
        return
    rules = v.personality.missions.rules
    state, who = v.exchange.transfer, client(link, m)
    take(v, transfer.on_item(state, who, m.mission_type, m.seq, item, integer, v.now_ms, rules))


def go_to(v: Vehicle, item: Item) -> Verdict:
    """ArduPilot: an item that is no part of a mission is a place to fly to in GUIDED, now."""
    verdict = judge(item, Kind.MISSION)
    if verdict is not Verdict.ACCEPTED or item.command != WAYPOINT:
        return verdict if verdict is not Verdict.ACCEPTED else Verdict.UNSUPPORTED
    goal = place(item, v.origin, v.commander.home or (0.0, 0.0, 0.0), v.position())
    taken = v.commander.reposition(Destination(goal, math.nan, 0.0, 0))
    return Verdict.ACCEPTED if taken is Result.ACCEPTED else Verdict.ERROR


def mission_request_partial_list(v: Vehicle, link: Link, message: Message) -> None:
    """Parts of plans are not transferred: refused at once."""
    take(v, (v.exchange.transfer, (Ack(client(link, message), message.mission_type, Verdict.UNSUPPORTED),)))


def mission_request_list(v: Vehicle, link: Link, message: Message) -> None:
    kind = message.mission_type
    items = {Kind.MISSION: shown(v), Kind.FENCE: v.commander.plans.fence}.get(kind, ())
    rules = v.personality.missions.rules
    take(v, transfer.on_list(v.exchange.transfer, client(link, message), kind, items, v.now_ms, rules))


def mission_request_int(v: Vehicle, link: Link, message: Message) -> None:
    _request(v, link, message, True)


def mission_request(v: Vehicle, link: Link, message: Message) -> None:
    _request(v, link, message, False)


def _request(v: Vehicle, link: Link, m: Message, integer: bool) -> None:
    state = v.exchange.transfer
    take(v, transfer.on_request(state, client(link, m), m.mission_type, m.seq, integer, v.now_ms))


def mission_ack(v: Vehicle, link: Link, message: Message) -> None:
    take(v, transfer.on_ack(v.exchange.transfer, client(link, message)))


def mission_clear_all(v: Vehicle, link: Link, message: Message) -> None:
    rules = v.personality.missions.rules
    take(v, transfer.on_clear(v.exchange.transfer, client(link, message), message.mission_type, rules))


def mission_set_current(v: Vehicle, link: Link, message: Message) -> None:
    set_current(v, message.seq)


def set_current(v: Vehicle, seq: int) -> Result:
    """Go on with the mission at an item."""
    plans = v.commander.plans
    if not 0 <= seq < len(plans.mission):
        v.commander.say("WPM: WP CURR CMD: Not in list", CRITICAL)
        return Result.FAILED
    plans.go_to(seq)
    return Result.ACCEPTED


# Ticks


def tell_progress(v: Vehicle, links: Sequence[Link]) -> None:
    """Every tick: ask again for items that did not come, and tell everybody of progress."""
    if v.exchange.transfer is not IDLE:
        take(v, transfer.on_time(v.exchange.transfer, v.now_ms, v.personality.missions.rules))
    plans = v.commander.plans
    if not plans.reached and v.exchange.told_current == plans.current:
        return
    for seq in plans.reached:
        _to_all(links, (pack("MISSION_ITEM_REACHED", seq=seq),))
    plans.reached.clear()
    if v.exchange.told_current != plans.current:
        v.exchange.told_current = plans.current
        _to_all(links, (v.personality.messages["MISSION_CURRENT"](v),))


def _to_all(links: Sequence[Link], payloads: Iterable[Payload | None]) -> None:
    for payload in payloads:
        for link in links:
            if payload is not None and link.streaming:
                link.send(payload)
