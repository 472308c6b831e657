"""What passes over the bus is in the file, byte for byte, also when the recorder is killed."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import msgspec
import pytest
from mcap.reader import make_reader

from bus import topics
from bus.messages import Command, CommandReply
from bus.session import free_endpoint, open_session
from mission import flight_log
from mission.json_schema import json_schema
from mission.recorder import MESSAGES, Recorder

TOPIC = {topic.name: topic for topic in topics.TOPICS}


@pytest.fixture
def run(tmp_path, flight, record):
    command = [("command", Command(name="start")), ("command", CommandReply(accepted=True, reason=""))]
    return record(tmp_path, [*command, *flight])


def test_every_message_is_there_byte_for_byte_and_in_order(run, flight):
    log = flight_log.read(run)
    assert log.complete
    assert log.lost_bytes == 0
    assert log.vehicle == "t"
    recorded = [
        (entry.topic, entry.payload) for entry in log.entries if entry.topic not in ("end", "command", "command/reply")
    ]
    assert recorded == [(name, topics.encode(message)) for name, message in flight]


def test_messages_come_back_by_topic_and_by_slot(run, flight):
    log = flight_log.read(run)
    assert log.messages(topics.LINK) == [message for name, message in flight if name == "rf/link"]
    assert sorted(log.by_slot(topics.ACTION)) == [0, 1, 2, 3, 4]
    assert log.by_slot(topics.SLOT)[5].closing


def test_the_file_says_what_it_holds(run):
    """As Foxglove sees it: through the index, with channels named by key expression and JSON schemas."""
    with (run / "flight.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.chunk_indexes
    by_topic = {channel.topic: channel for channel in summary.channels.values()}
    assert set(by_topic) >= {f"star/t/{name}" for name in TOPIC}
    for name, topic in TOPIC.items():
        channel = by_topic[f"star/t/{name}"]
        schema = summary.schemas[channel.schema_id]
        assert channel.message_encoding == "json"
        assert schema.encoding == "jsonschema"
        assert schema.name == f"aerialstar.{topic.message.__name__}.v1"
        assert json.loads(schema.data) == json_schema(topic.message)


def foxglove_accepts(schema, place=""):
    """The rules of the reader in Foxglove's open-source release (mcap-support, parseJsonSchema)."""
    assert schema["type"] == "object", place
    for name, field in schema["properties"].items():
        kind = field["items"]["type"] if field["type"] == "array" else field["type"]
        assert kind in ("boolean", "string", "number", "integer", "object"), f"{place}.{name}"
        if kind == "object":
            foxglove_accepts(field.get("items", field), f"{place}.{name}")


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.__name__)
def test_schemas_name_every_field_and_pass_foxgloves_rules(message):
    schema = json_schema(message)
    foxglove_accepts(schema)
    described = set(schema["properties"]) | {name.strip("^$") for name in schema.get("patternProperties", {})}
    assert described == {field.name for field in msgspec.structs.fields(message)}
    assert "$ref" not in json.dumps(schema)


def test_a_file_cut_anywhere_gives_what_was_whole(run, tmp_path_factory):
    whole = (run / "flight.mcap").read_bytes()
    entries = flight_log.read(run).entries
    folder = tmp_path_factory.mktemp("cut")
    seen = 0
    footer = len(whole) - 8  # the magic bytes after it carry nothing
    for size in range(100, footer, max(1, len(whole) // 200)):
        (folder / "flight.mcap").write_bytes(whole[:size])
        log = flight_log.read(folder)
        assert not log.complete
        assert log.entries == entries[: len(log.entries)]
        assert len(log.entries) >= seen
        assert log.lost_bytes < size
        seen = len(log.entries)
    assert seen == len(entries)


CHUNK = 6
"""MCAP's opcode."""


def test_a_writer_killed_before_it_filled_in_a_chunks_lengths_loses_that_chunk_only(run, tmp_path):
    """The writer puts 2^64 - 1 where record and data lengths go, and comes back when the chunk is whole."""
    whole = (run / "flight.mcap").read_bytes()
    entries = flight_log.read(run).entries
    at, chunks = 8, []  # after the magic bytes, records: opcode, length, content
    while at < len(whole) - 8:
        chunks += [at] if whole[at] == CHUNK else []
        at += 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
    unknown = b"\xff" * 8
    header = bytes([CHUNK]) + unknown + bytes(8 + 8 + 8 + 4) + bytes(4) + unknown
    cut = chunks[-2]
    (tmp_path / "flight.mcap").write_bytes(whole[:cut] + header + b'{"half')
    log = flight_log.read(tmp_path)
    assert not log.complete
    assert 0 < len(log.entries) < len(entries)
    assert log.entries == entries[: len(log.entries)]


@pytest.mark.parametrize("content", [None, b"not an mcap file at all"])
def test_what_is_no_log_is_a_clear_error(tmp_path, content):
    if content is not None:
        (tmp_path / "flight.mcap").write_bytes(content)
    with pytest.raises(flight_log.FlightLogError, match=str(tmp_path)):
        flight_log.read(tmp_path)


def test_a_killed_recorder_loses_at_most_the_message_in_hand(tmp_path):
    code = (
        "import sys, time, pathlib\n"
        "from bus.session import open_session\n"
        "from mission.recorder import Recorder\n"
        "session = open_session(listen=sys.argv[1])\n"
        "recorder = Recorder(session, 't', pathlib.Path(sys.argv[2]) / 'flight.mcap')\n"
        "print('up', flush=True); time.sleep(600)"
    )
    endpoint = free_endpoint()
    child = subprocess.Popen([sys.executable, "-c", code, endpoint, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == "up\n"
        with open_session(connect=[endpoint]) as sender:
            for index in range(50):
                sender.put(topics.key("t", "event"), json.dumps({"index": index}))
            deadline = time.monotonic() + 10.0
            while not (log := flight_log.read(tmp_path)).entries or json.loads(log.entries[-1].payload)["index"] < 48:
                assert time.monotonic() < deadline, "all but the last message must reach the disk without a close"
                time.sleep(0.01)
            os.kill(child.pid, signal.SIGKILL)
            child.wait()
    finally:
        child.kill()
        child.communicate()
    log = flight_log.read(tmp_path)
    assert not log.complete
    assert [json.loads(entry.payload)["index"] for entry in log.entries] in (list(range(49)), list(range(50)))


def test_a_full_disk_is_told_and_stops_nothing(tmp_path):
    code = (
        "import resource, sys, pathlib\n"
        "from bus.messages import Command\n"
        "from bus.session import open_session, free_endpoint\n"
        "from mission.recorder import Recorder\n"
        "with open_session(listen=free_endpoint()) as session:\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))\n"
        "    with Recorder(session, 't', pathlib.Path(sys.argv[1])) as recorder:\n"
        "        for _ in range(100): recorder.command(Command(name='hold'))\n"
        "    print(recorder.error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "flight.mcap")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "File too large" in done.stdout
    assert done.stderr == "", "foxglove-sdk has nothing to say about it"
    assert flight_log.read(tmp_path).entries


def test_many_threads_at_once_do_not_block_each_other(tmp_path):
    """zenoh calls back from one thread for each peer."""
    with open_session(listen=free_endpoint()) as session:
        recorder = Recorder(session, "t", tmp_path / "flight.mcap")

        def send():
            for _ in range(2000):
                recorder.command(Command(name="hold"))

        threads = [threading.Thread(target=send, daemon=True) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(60.0)
        assert not any(thread.is_alive() for thread in threads)
        recorder.close()
    assert len(flight_log.read(tmp_path).entries) == 8000
