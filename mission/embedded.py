"""The embedded autopilots of a mission: as few simulator processes as can play them, and how these are started."""

import os
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

from mission.mission_file import Mission
from mission.supervisor import python
from sitl.origin import Origin

FAILSAFE_SPEED = 10.0
"""How fast the embedded autopilot flies its failsafe after a lockstep flight lost its bridge: nobody's clock runs."""
WITH_FAILSAFES = {"px4": {"COM_LOW_BAT_ACT": 3.0}, "arducopter": {"BATT_FS_LOW_ACT": 2.0}}
"""What the embedded autopilot starts with besides its defaults, which leave a low battery to the pilot: it returns."""
TOGETHER = 10
"""One process gives only its first ten vehicles a companion port of their own."""
BASE_PORT, LAST_PORT = 20000, 32000
"""Where free ports in a row are looked for: below those that the system gives away by itself."""


@dataclass(frozen=True)
class Simulator:
    """One process, and whom it plays: vehicles that differ only in what it counts on by itself."""

    missions: tuple[Mission, ...]
    place: int
    """Of the first one among all embedded vehicles: so many spacings east of the first home."""

    @property
    def name(self) -> str:
        return "sitl" if self.place == 0 else f"sitl_{self.missions[0].vehicle.name}"

    @property
    def ready(self) -> str:
        """What it prints, with an address behind it, once it can be flown."""
        if self.missions[0].clock == "lockstep":
            return "control "
        return f"vehicle {self.missions[-1].vehicle.system_id} companion " if len(self.missions) > 1 else "companion "


def simulators(missions: Sequence[Mission]) -> list[Simulator]:
    """Who is played together: vehicles beside each other with consecutive system ids and the same of all else."""
    groups: list[list[Mission]] = []
    for mission in missions:
        if not mission.embedded:
            continue
        last = groups[-1] if groups else []
        if last and len(last) < TOGETHER and _alike(last[-1], mission):
            last.append(mission)
        else:
            groups.append([mission])
    places = [sum(map(len, groups[:number])) for number in range(len(groups))]
    return [Simulator(tuple(group), place) for group, place in zip(groups, places, strict=True)]


def _alike(before: Mission, mission: Mission) -> bool:
    one, other = before.vehicle, mission.vehicle
    same = (one.sitl, one.signing_key) == (other.sitl, other.signing_key)
    return same and other.system_id == one.system_id + 1


def command(simulator: Simulator, companion_port: int, seed: int, spacing_m: float) -> list[str]:
    """The command line of a simulator that sends to `companion_port` and the ports after it, one for each vehicle."""
    first, origin = simulator.missions[0], Origin()
    lockstep = first.clock == "lockstep"
    key, played = first.vehicle.signing_key, first.vehicle.sitl
    latitude, longitude = origin.globe(0.0, simulator.place * spacing_m)
    several = (
        *("--vehicles", str(len(simulator.missions)), "--spacing", str(spacing_m)),
        *("--home", f"{latitude!r},{longitude!r},{origin.altitude!r}"),
    )
    return python(
        "sitl",
        *("--personality", played.personality),
        *(("--signing-key", str(key)) if key is not None else ()),
        *("--companion-port", str(companion_port), "--companion-bind", "0", "--gcs-bind", "0"),
        *(("--lockstep", "--control-port", "0") if lockstep else ()),
        *("--speed", str(FAILSAFE_SPEED if lockstep else first.speed), "--exit-when-landed"),
        *("--launcher", str(os.getpid())),
        *("--seed", str(seed + simulator.place), "--system-id", str(first.vehicle.system_id)),
        *(several if simulator.place or len(simulator.missions) > 1 else ()),
        *(("--tcp-port", "0") if played.personality == "arducopter" else ()),  # two flights at once are no conflict
        *(
            part
            for name, value in (WITH_FAILSAFES[played.personality] | played.parameters).items()
            for part in ("--param", f"{name}={value:g}")
        ),
    )


def free_udp_ports(count: int) -> int:
    """The first of `count` UDP ports in a row on loopback that were free a moment ago. Raises OSError."""
    if count <= 1:
        return bindable(0)
    start = BASE_PORT + os.getpid() * TOGETHER % (LAST_PORT - BASE_PORT)  # two launchers do not look in one place
    for first in chain(range(start, LAST_PORT, count), range(BASE_PORT, start, count)):
        try:
            for port in range(first, first + count):
                bindable(port)
        except OSError:
            continue
        return first
    raise OSError(f"no {count} free UDP ports in a row from {BASE_PORT} to {LAST_PORT}")


def bindable(port: int) -> int:
    """The port (of 0: one that the system chose), which is free. Raises OSError when it is not."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", port))
        taken: int = probe.getsockname()[1]
        return taken
