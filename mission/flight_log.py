"""Reading `flight.mcap` of a run folder, whole or cut short by a crash."""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Footer
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from bus.messages import Action as ActionMessage
from bus.messages import ChannelState, LinkReport, Message, RisConfiguration, SlotOpened
from bus.topics import RefusedError, Topic, decode

M = TypeVar("M", bound=Message)
Slotted = TypeVar("Slotted", SlotOpened, ChannelState, ActionMessage, RisConfiguration, LinkReport)

FILE_NAME = "flight.mcap"


class FlightLogError(ValueError):
    """There is no readable log in this folder; the text says why."""


@dataclass(frozen=True)
class Entry:
    """One recorded message: topic without `star/<vehicle>/`, wall clock at receipt [s], wire form."""

    topic: str
    wall_s: float
    payload: bytes


@dataclass(frozen=True)
class FlightLog:
    """All that can be read of a log, in the order of receipt."""

    path: Path
    vehicle: str
    entries: tuple[Entry, ...]
    complete: bool
    """False when the recorder was killed: the file has no end."""
    lost_bytes: int
    """Bytes after the last whole record: less than one message when the recorder was killed."""

    def messages(self, topic: Topic[M]) -> list[M]:
        """The good messages of a topic, in order; bad payloads are left out, as on the bus."""
        found = []
        for entry in self.entries:
            if entry.topic == topic.name:
                try:
                    found.append(decode(entry.payload, topic.message))
                except RefusedError:
                    continue
        return found

    def by_slot(self, topic: Topic[Slotted]) -> dict[int, Slotted]:
        """The first message of each slot: a restarted node may repeat itself, the loop acts on the first."""
        slots: dict[int, Slotted] = {}
        for message in self.messages(topic):
            slots.setdefault(message.slot, message)
        return slots


def read(run: Path) -> FlightLog:
    """Read the log of a run folder. Raises FlightLogError when there is none, or it is no MCAP file."""
    path = run / FILE_NAME
    if not path.is_file():
        raise FlightLogError(f"{run}: no {FILE_NAME} in it (is it a run folder, recorded with record.mcap: true?)")
    topics: dict[int, str] = {}
    entries: list[Entry] = []
    vehicle = ""
    complete = False
    with path.open("rb") as file:
        if not MCAP0_MAGIC.startswith(file.read(len(MCAP0_MAGIC))):
            raise FlightLogError(f"{path}: not an MCAP file")
        read_to = file.seek(0)
        try:
            for record in StreamReader(file, emit_chunks=True).records:
                for item in breakup_chunk(record) if isinstance(record, Chunk) else [record]:
                    if isinstance(item, Channel):
                        _, vehicle, topics[item.id] = item.topic.split("/", 2)
                    elif isinstance(item, McapMessage):
                        entries.append(Entry(topics[item.channel_id], item.log_time / 1e9, item.data))
                complete = isinstance(record, Footer)
                read_to = file.tell()
        except (McapError, struct.error, zstandard.ZstdError, ValueError, KeyError, OverflowError):
            pass  # cut here; OverflowError: the writer died before it filled in a length, which reads 2^64 - 1
        size = file.seek(0, 2)
    return FlightLog(path, vehicle, tuple(entries), complete, 0 if complete else size - read_to)
