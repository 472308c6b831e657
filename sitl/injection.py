"""Faults on request: `inject ...` on the control socket. What is injected, the vehicle has to notice for itself."""

import math
from collections.abc import Callable

from sitl.autopilot import Autopilot
from sitl.flight.sensors import Faults, Loss

MOTORS = 4
NUMBERS = tuple(str(motor) for motor in range(1, MOTORS + 1))


def number(text: str, what: str, low: float, high: float) -> float:
    """A number in [low, high]. Raises ValueError naming what it is."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise ValueError(f"inject {what}: {text!r} is not a number in {low:g} to {high:g}")
    return value


def word(what: Loss) -> str:
    """What a loss is called in a request."""
    return f"{what.name.lower()}_loss"


def _lose(what: Loss) -> Callable[[Autopilot, list[str]], None]:
    """A handler that takes something away for so many seconds; without a number for good, 0 gives it back."""

    def lose(autopilot: Autopilot, words: list[str]) -> None:
        if len(words) > 1:
            raise ValueError(f"inject {word(what)}: takes [seconds], not {' '.join(words)!r}")
        seconds = number(words[0], word(what), 0.0, 1e6) if words else math.inf
        autopilot.vehicle.model.faults.lose(what, autopilot.now_ms + seconds * 1000.0)

    return lose


def motor(autopilot: Autopilot, words: list[str]) -> None:
    """`<1 to 4 | all> fail | ok | <share of its thrust>`"""
    if len(words) != 2:
        raise ValueError("inject motor: takes <1 to 4 or all> <fail, ok or a share of its thrust>")
    which, how = words
    left = {"fail": 0.0, "ok": 1.0}.get(how)
    if left is None:
        left = number(how, "motor", 0.0, 1.0)
    if which not in NUMBERS and which != "all":
        raise ValueError(f"inject motor: {which!r} is not one of {', '.join(NUMBERS)} and all")
    index = None if which == "all" else NUMBERS.index(which)
    set_motor(autopilot.vehicle.model.faults, index, left)
    if left == 1.0 and index is None:
        autopilot.vehicle.model.repair()


def set_motor(faults: Faults, index: int | None, left: float) -> None:
    """What is left of a motor's thrust; None: of all."""
    for i in range(MOTORS):
        if index in (None, i):
            faults.motors[i] = left


def battery(autopilot: Autopilot, words: list[str]) -> None:
    """`<remaining share>`"""
    if len(words) != 1:
        raise ValueError("inject battery: takes <remaining charge, 0 to 1>")
    autopilot.vehicle.commander.battery.leave(number(words[0], "battery", 0.0, 1.0))


def wind(autopilot: Autopilot, words: list[str]) -> None:
    """`<north>,<east>,<down> [wind of the gusts at 20 ft]` [m/s]: sets SITL_WIND_* and SITL_GUST_W20."""
    axes = words[0].split(",") if words else []
    if len(axes) != 3 or len(words) > 2:
        raise ValueError("inject wind: takes <north>,<east>,<down> [gusts of this wind at 20 ft], in m/s")
    p = autopilot.vehicle.parameters
    wanted = dict(zip(("SITL_WIND_N", "SITL_WIND_E", "SITL_WIND_D"), axes, strict=True))
    if len(words) == 2:
        wanted["SITL_GUST_W20"] = words[1]
    values = {
        name: number(text, "wind", p.parameter(name).low, p.parameter(name).high) for name, text in wanted.items()
    }
    for name, value in values.items():
        p.set(name, value)


def nothing(autopilot: Autopilot, words: list[str]) -> None:
    """Take back losses and motor failures; charge and wind stay as they are."""
    if words:
        raise ValueError(f"inject ok: takes no argument, not {' '.join(words)!r}")
    model = autopilot.vehicle.model
    for what in Loss:
        model.faults.lose(what, 0.0)
    model.repair()


INJECTIONS: dict[str, Callable[[Autopilot, list[str]], None]] = {
    **{word(what): _lose(what) for what in Loss},
    "motor": motor,
    "battery": battery,
    "wind": wind,
    "ok": nothing,
}


def inject(autopilot: Autopilot, argument: str) -> str:
    """Serve `inject <what> [arguments]`. Raises ValueError with what is wrong; nothing is injected then."""
    words = argument.split()
    handler = INJECTIONS.get(words[0]) if words else None
    if handler is None:
        raise ValueError(f"inject: {argument!r} is not one of {', '.join(INJECTIONS)}")
    handler(autopilot, words[1:])
    return f"injected {' '.join(words)}"
