"""Fuzz tests: scripts of raw bytes, well-formed frames with any payload, and time, played to both autopilots."""

from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.links.frames import Payload, frame, layout, split
from tests.sitl.fuzzing import HANDLED, Datagram, Said, Wait, encoded, prepared

likely_bytes = st.sampled_from([b"\x00", b"\x01", b"\xff", b"\x7f\xc0\x00\x00"[::-1], b"\x80\x7f", b"\xff\xff\xff\x7f"])
payloads = st.one_of(
    st.binary(max_size=255),
    st.lists(st.one_of(likely_bytes, st.binary(min_size=4, max_size=4)), max_size=60).map(b"".join),
)
said = st.builds(Said, st.sampled_from(HANDLED), payloads, st.sampled_from([True, True, True, False]))
raw = st.one_of(
    st.binary(max_size=600),
    st.binary(max_size=300).map(lambda tail: b"\xfd" + tail),
    st.tuples(said, st.integers(0, 300)).map(lambda cut: encoded(cut[0])[: cut[1]]),
    st.lists(said, max_size=6).map(lambda many: b"".join(map(encoded, many))),
)
scripts = st.lists(
    st.one_of(st.builds(Datagram, raw), said, said, said, st.builds(Wait, st.sampled_from([1, 10, 50, 700]))),
    max_size=30,
)


@settings(max_examples=40, deadline=None)
@given(scripts)
@pytest.mark.parametrize("flying", [False, True])
@pytest.mark.parametrize("name", ["px4", "arducopter"])
def test_a_vehicle_bears_any_script(name, flying, script):
    prey = prepared(name, flying)
    prey.play(script)
    prey.check()


@given(st.lists(said, max_size=8), st.binary(max_size=40).filter(lambda b: not {0xFD, 0xFE} & set(b)))
def test_frames_are_found_however_a_stream_is_cut(many, between):
    """A byte stream in pieces gives the same frames as in one, and garbage between frames hides none of them."""
    frames = [encoded(one) for one in many]
    stream = between.join([b"", *frames, b""])
    whole, rest = split(stream, Counter())
    assert [one.raw for one in whole] == frames
    assert not rest
    pending, pieces = b"", []
    for k in range(0, len(stream), 7):
        good, pending = split(pending + stream[k : k + 7], Counter())
        pieces += [one.raw for one in good]
    assert pieces == frames


@given(st.sampled_from(HANDLED), payloads, st.integers(0, 255), st.integers(0, 7))
def test_one_flipped_bit_is_never_a_good_frame(name, payload, place, bit):
    form = layout(name)
    good = bytearray(frame(Payload(form.message_id, form.crc_extra, payload[:255]), 0, 1, 1))
    good[place % len(good)] ^= 1 << bit
    found, _ = split(bytes(good), Counter())
    assert bytes(good) not in [one.raw for one in found]


@given(st.binary(max_size=2000))
def test_every_byte_is_accounted_for(data):
    """What is not a good frame is counted or left over, and what is left over is shorter than a frame."""
    bad: Counter[str] = Counter()
    good, rest = split(data, bad)
    assert len(rest) < 280
    assert bad.total() or sum(len(one.raw) for one in good) + len(rest) == len(data)
