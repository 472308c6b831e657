"""Answers readers of a per-slot topic: the latest message, or that of `?slot=K`."""

import re
from typing import Any, Generic, TypeVar

import zenoh

from bus import topics
from bus.messages import LinkReport, RisConfiguration

PerSlot = TypeVar("PerSlot", RisConfiguration, LinkReport)

KEPT_SLOTS = 10_000
SLOT_NUMBER = re.compile(r"[0-9]{1,18}")


class History(Generic[PerSlot]):
    """A queryable on a topic's own key over the messages of a flight's last `KEPT_SLOTS` slots.

    A slot that does not follow the last one begins another flight, of which nothing is known yet.
    """

    def __init__(self, session: zenoh.Session, vehicle: str, topic: topics.Topic[PerSlot]) -> None:
        self._topic: topics.Topic[PerSlot] = topic
        self._key = topics.key(vehicle, topic.name)
        self._messages: dict[int, bytes] = {}
        self._latest: tuple[int, bytes] | None = None
        self._queryable: Any = session.declare_queryable(self._key, self._answer)

    def keep(self, message: PerSlot) -> None:
        """Make a message the latest and the one of its slot."""
        payload = topics.encode(message)
        if self._latest is not None and message.slot <= self._latest[0]:
            self._messages.clear()
        self._messages[message.slot] = payload
        self._latest = (message.slot, payload)
        if len(self._messages) > KEPT_SLOTS:
            del self._messages[next(iter(self._messages))]

    def undeclare(self) -> None:
        self._queryable.undeclare()

    def _answer(self, query: zenoh.Query) -> None:
        """On zenoh's thread."""
        with query:
            asked = query.parameters.get("slot")
            if asked is None:
                payload = None if self._latest is None else self._latest[1]
            elif SLOT_NUMBER.fullmatch(asked):
                payload = self._messages.get(int(asked))
            else:
                query.reply_err(f"slot: {asked[:32]!r} is not a slot number".encode())
                return
            if payload is None:
                query.reply_err(f"slot: nothing kept for {'any slot yet' if asked is None else int(asked)}".encode())
            else:
                query.reply(self._key, payload, encoding=self._topic.encoding)
