"""All links of one vehicle: what comes in is believed or not, passed on, and handed to the vehicle if it is for it.

The routing rules of MAVLink (mavlink.io, "Routing"): a frame for everybody goes to every other link that somebody
speaks on, a frame for somebody else to the links on which that system was heard.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Protocol

from sitl.links.frames import Frame
from sitl.links.link import AUTOPILOT, Link
from sitl.links.signing import RADIO_STATUS, SETUP_SIGNING, Signing

NEVER_FORWARDED = frozenset({RADIO_STATUS, SETUP_SIGNING})
"""About the link they came on; and a key must not be spread."""
ROUTES_MAX = 256
"""Systems and components remembered per link."""


class Port(Protocol):
    """A socket and the links on it."""

    name: str
    links: list[Link]
    counters: Counter[str]
    """What came on it from nobody that has a link."""

    def receive(self, now_ms: int) -> Iterable[tuple[Link, Frame]]: ...

    def lost(self) -> dict[Link | None, int]: ...

    def flush(self) -> None: ...

    def close(self) -> None: ...


class Network:
    """The ports of a vehicle; `signing` is that of their links."""

    def __init__(self, ports: Sequence[Port], system: int, signing: Signing) -> None:
        self._ports = ports
        self._system = system
        self._signing = signing
        self._routes: dict[Link, set[tuple[int, int]]] = {}
        self.links = self._open()
        """Every link there was when the ports were last read."""

    def _open(self) -> list[Link]:
        return [link for port in self._ports for link in port.links]

    def receive(self, now_ms: int, unix_us: int, any_component: bool = False) -> list[tuple[Link, Frame]]:
        """What came for this vehicle; the rest has been passed on.

        `any_component`: take what is for another component of this system too, unless that component is known.
        """
        self._signing.tick(unix_us)
        ours: list[tuple[Link, Frame]] = []
        for port in self._ports:
            for link, received in port.receive(now_ms):
                refusal = self._signing.refusal(received)
                if refusal:
                    link.counters[refusal] += 1
                elif self._is_ours(received, self._forward(link, received), any_component):
                    ours.append((link, received))
                else:
                    link.counters["not for us"] += 1
        self.links = self._open()
        return ours

    def _is_ours(self, received: Frame, forwarded: bool, any_component: bool) -> bool:
        if received.target_system not in (0, self._system):
            return False
        return received.target_component in (0, AUTOPILOT) or (any_component and not forwarded)

    def _forward(self, origin: Link, received: Frame) -> bool:
        """Learn where the sender is, and pass the frame on to where it should go."""
        sender = (received.system, received.component)
        if sender == (self._system, AUTOPILOT):  # our own, come back, or somebody who plays us
            return False
        links = self._open()
        routes = self._routes.setdefault(origin, set())
        if received.system and len(routes) < ROUTES_MAX:
            routes.add(sender)
        if len(self._routes) > len(links):
            self._routes = {link: known for link, known in self._routes.items() if link in links}
        to_us = received.target_system == self._system and received.target_component == AUTOPILOT
        if len(links) == 1 or to_us or received.message_id in NEVER_FORWARDED:
            return False
        forwarded = False
        for link in links:
            if link is not origin and link.heard and self._leads(self._routes.get(link, ()), sender, received):
                link.forward(received.raw)
                forwarded = True
        return forwarded

    def _leads(self, known: Iterable[tuple[int, int]], sender: tuple[int, int], received: Frame) -> bool:
        """Whether a link on which `known` were heard leads to whom a frame is for."""
        system, component = received.target_system, received.target_component
        if system == 0:
            return sender not in known  # or else a loop of links would send it round for ever
        if system == self._system and component:
            return (system, component) in known
        return any(system == other for other, _ in known)

    def counters(self) -> dict[str, dict[str, int]]:
        """What every link, and every port of strangers, has counted; `lost` is what the kernel had no room for."""
        counted: dict[str, dict[str, int]] = {}
        for port in self._ports:
            lost = port.lost()
            for link in port.links:
                counted[f"{link.name} {link.number}"] = {**link.counters, "sent": link.sent, "lost": lost.get(link, 0)}
            counted[f"{port.name} strangers"] = {**port.counters, "lost": lost.get(None, 0)}
        return counted

    def flush(self) -> None:
        """Send what waits to be sent."""
        for port in self._ports:
            port.flush()

    def close(self) -> None:
        """Close all sockets."""
        for port in self._ports:
            port.close()
