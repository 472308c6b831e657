"""Coverage-guided fuzzing of the simulated autopilot: `make fuzz` (needs the extra `fuzz`; not part of the tests).

    python -m tests.fuzz.fuzz_autopilot [libFuzzer options, e.g. -max_total_time=600] [corpus folder]

Bytes become a script of `tests.sitl.fuzzing`: datagrams, well-formed frames of the handled messages, vehicle time.
A vehicle that raises, keeps a defect, loses its state or stops answering is a finding, which libFuzzer writes down.
"""

import sys

import atheris

import sitl.flight.flight_model  # noqa: F401 - compiled code cannot be instrumented: imported before

with atheris.instrument_imports(include=["sitl"]):
    from tests.sitl.fuzzing import HANDLED, Datagram, Said, Step, Wait, prepared

STEPS_MAX = 40


def script(data: bytes) -> tuple[bool, bool, list[Step]]:
    """Whether it is an ArduCopter, whether it flies, and what happens to it."""
    source = atheris.FuzzedDataProvider(data)
    copter, flying = source.ConsumeBool(), source.ConsumeBool()
    steps: list[Step] = []
    while source.remaining_bytes() and len(steps) < STEPS_MAX:
        kind = source.ConsumeIntInRange(0, 5)
        if kind == 0:
            steps.append(Datagram(source.ConsumeBytes(source.ConsumeIntInRange(0, 600))))
        elif kind == 1:
            steps.append(Wait(source.ConsumeIntInRange(1, 1000)))
        else:
            name = HANDLED[source.ConsumeIntInRange(0, len(HANDLED) - 1)]
            payload = source.ConsumeBytes(source.ConsumeIntInRange(0, 255))
            steps.append(Said(name, payload, source.ConsumeIntInRange(0, 3) > 0))
    return copter, flying, steps


def one_input(data: bytes) -> None:
    copter, flying, steps = script(data)
    prey = prepared("arducopter" if copter else "px4", flying)
    prey.play(steps)
    prey.check()


if __name__ == "__main__":
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()
