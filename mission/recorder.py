"""Every bus message of one vehicle, as it came, into `flight.mcap`.

The file is written by foxglove-sdk with a chunk for every message over an unbuffered file: a chunk is whole on disk as
soon as the next message comes, so a killed process loses one message at most, and Foxglove still finds its index.

Only one thread touches foxglove-sdk: it holds a lock of its own while it calls back into Python to write, so that two
threads that log would wait for each other for ever.
"""

import os
import queue
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import foxglove
import msgspec
import zenoh
from foxglove.mcap import MCAPWriteOptions

from bus.messages import Command, CommandReply, Message
from bus.topics import COMMAND, TOPICS, encode, encoding, key
from mission.json_schema import json_schema

MESSAGES: tuple[type[Message], ...] = (*(topic.message for topic in TOPICS), Command, CommandReply)
BY_ENCODING = {str(encoding(message)): message for message in MESSAGES}


@dataclass(frozen=True)
class _Received:
    keyexpr: str
    encoding: str
    payload: bytes
    wall_ns: int


class _File:
    """What foxglove-sdk writes to.

    The first error (e.g. a full disk) is kept and ends the writing, but the SDK, which would print a traceback for each
    message from then on, sees a file that goes on growing.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        self._position = 0
        self.error: OSError | None = None

    def write(self, data: bytes | bytearray) -> int:
        written = len(data)
        if self.error is None:
            try:
                written = self._file.write(data)
            except OSError as error:
                self.error = error
        self._position += written
        return written

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        if self.error is None:
            self._position = self._file.seek(offset, whence)
        else:
            self._position = offset + (0 if whence == os.SEEK_SET else self._position)
        return self._position

    def flush(self) -> None:
        """Nothing is buffered."""

    def close(self) -> None:
        self._file.close()


class Recorder:
    """Records `star/<vehicle>/**` from construction until `close` (or the end of the `with` block).

    `log_time` is the wall clock at receipt. A message of unknown encoding is kept too, without a schema.
    Raises OSError when the file cannot be made (it must not exist).
    """

    def __init__(self, session: zenoh.Session, vehicle: str, path: Path) -> None:
        self._vehicle = vehicle
        self._file = _File(path)
        self._context = foxglove.Context()
        self._writer = foxglove.open_mcap(
            self._file,
            context=self._context,
            writer_options=MCAPWriteOptions(chunk_size=1, compression_threads=0),
        )
        self._channels: dict[tuple[str, str], foxglove.Channel] = {}
        self._waiting: queue.SimpleQueue[_Received | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write_all, name="recorder", daemon=True)
        self._thread.start()
        self._subscriber = session.declare_subscriber(key(vehicle, "**"), self._on_sample)

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def error(self) -> OSError | None:
        """Why recording stopped (e.g. the disk is full), or None."""
        return self._file.error

    def command(self, message: Command | CommandReply) -> None:
        """Record a command (as `command`) or its reply (as `command/reply`): queries do not pass a subscriber."""
        topic = COMMAND if isinstance(message, Command) else f"{COMMAND}/reply"
        self._receive(key(self._vehicle, topic), str(encoding(type(message))), encode(message))

    def close(self) -> None:
        """Write what was received, then the index. Does nothing the second time."""
        if self._thread.is_alive():
            self._subscriber.undeclare()  # type: ignore[no-untyped-call]  # zenoh gives no types here
            self._waiting.put(None)
            self._thread.join()
            self._file.close()

    def _on_sample(self, sample: zenoh.Sample) -> None:
        self._receive(str(sample.key_expr), str(sample.encoding), sample.payload.to_bytes())

    def _receive(self, keyexpr: str, wire_encoding: str, payload: bytes) -> None:
        self._waiting.put(_Received(keyexpr, wire_encoding, payload, time.time_ns()))

    def _write_all(self) -> None:
        while (received := self._waiting.get()) is not None:
            if self._file.error is None:
                channel = self._channel(received.keyexpr, received.encoding)
                channel.log(received.payload, log_time=received.wall_ns)
        self._writer.close()

    def _channel(self, keyexpr: str, wire_encoding: str) -> foxglove.Channel:
        channel = self._channels.get((keyexpr, wire_encoding))
        if channel is None:
            channel = foxglove.Channel(
                keyexpr,
                schema=_schema(wire_encoding),
                message_encoding="json" if wire_encoding.startswith("application/json") else wire_encoding,
                context=self._context,
            )
            self._channels[keyexpr, wire_encoding] = channel
        return channel


def _schema(wire_encoding: str) -> foxglove.Schema:
    message = BY_ENCODING.get(wire_encoding)
    if message is None:
        return foxglove.Schema(name=wire_encoding, encoding="", data=b"")
    name = wire_encoding.rsplit(";", 1)[-1]
    return foxglove.Schema(name=name, encoding="jsonschema", data=msgspec.json.encode(json_schema(message)))
