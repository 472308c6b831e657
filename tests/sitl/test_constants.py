"""The constants that go into compiled code come out as they went in."""

import itertools

from sitl.flight.constants import packed, unpacked_craft, unpacked_gains
from sitl.flight.control import Gains
from sitl.flight.physics import Rotorcraft
from sitl.parameters import Parameters
from sitl.px4.personality import PX4


def numbered(kind: type[Gains] | type[Rotorcraft], like: tuple, numbers: itertools.count) -> tuple:
    """Every number another one: a field read from the wrong place would show."""
    return kind(
        *(tuple(float(next(numbers)) for _ in v) if isinstance(v, tuple) else float(next(numbers)) for v in like)
    )


def test_every_constant_arrives_in_its_place():
    p, numbers = Parameters(PX4.table), itertools.count(1)
    gains = numbered(Gains, PX4.gains(p), numbers)
    craft = numbered(Rotorcraft, PX4.craft(p), numbers)
    flat = packed(gains, craft)
    assert len(flat) == next(numbers) - 1
    assert unpacked_gains(flat) == gains
    assert unpacked_craft(flat) == craft
