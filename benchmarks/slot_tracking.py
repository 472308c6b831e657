"""How well slots are tracked: a vehicle against its plan over 60 random slots, on both personalities.

    python benchmarks/slot_tracking.py [--slots 60] [--seeds 5]

Everything that decides is the bridge's own (slots, plan, tracker, envelope) and the simulated autopilot's own
(commander, control law, physics with its drag); only the wire between them is left out, so that an hour of flight takes
a minute. Limits, lead and reaction are those of the dialect. Directions are uniform on the sphere, lengths uniform up
to 5 or 10 m. The goals are those of issue 5: 0.8 m RMS (3-D, 10 Hz samples) up to 5 m/s, 1.2 m up to 10 m/s.
"""

import argparse
import math
from collections.abc import Iterator

import numpy as np
import torch

from airframe.displacement import spherical
from airframe.slot_profile import Vector
from autopilot_bridge.config import BridgeConfig, Limits
from autopilot_bridge.dialects import Dialect
from autopilot_bridge.dialects.arducopter import ARDUCOPTER
from autopilot_bridge.dialects.px4 import PX4
from autopilot_bridge.envelope import Envelope
from autopilot_bridge.fence import Fence
from autopilot_bridge.preflight import TRACKING_HEADROOM, VERTICAL_SHARE
from autopilot_bridge.slots import Slots
from autopilot_bridge.tracker import follow, track
from bus.messages import Action, FlownSlot
from sitl.flight.flight_model import FlightModel
from sitl.origin import read_origin
from sitl.parameters import Parameters
from sitl.personality import personality
from sitl.targets import PositionTarget

GOALS = {5.0: 0.8, 10.0: 1.2}
"""v_max [m/s] -> RMS [m]."""
DIALECTS: dict[str, Dialect] = {"px4": PX4, "arducopter": ARDUCOPTER}
STEP_MS = 50
HEIGHT_M = 60.0
VELOCITY_AND_YAW = 2503
NOTHING = (0.0, 0.0, 0.0)
GUIDED, OFFBOARD = 4, 6 << 16


class Vehicle:
    """A simulated autopilot in the air, without its links."""

    def __init__(self, name: str, **parameters: float) -> None:
        chosen = personality(name)  # type: ignore[arg-type]  # a test's parameter
        self.parameters = Parameters(chosen.table)
        for parameter, value in parameters.items():
            self.parameters.set(parameter, value)
        self._model = FlightModel(chosen.gains(self.parameters), chosen.craft(self.parameters))
        origin = read_origin("47.397743,8.545594,489.4")
        self._commander = chosen.commander(self.parameters, self._model, origin, lambda text, severity: None)
        self._take_off(name)

    def _take_off(self, name: str) -> None:
        commander = self._commander
        while not commander.ready:
            self.advance(500)
        if name == "arducopter":
            commander.set_mode(GUIDED)
            commander.arm(False)
            commander.takeoff(HEIGHT_M)
        else:
            self.parameters.set("MIS_TAKEOFF_ALT", HEIGHT_M)
            commander.arm(False)
            commander.takeoff(math.nan)
        self.advance(60_000)
        for _ in range(40):
            self.send(np.zeros(3))
            self.advance(STEP_MS)
        if name == "px4":
            commander.set_mode(OFFBOARD)

    def advance(self, duration_ms: int) -> None:
        """Let vehicle time pass, in ticks of 10 ms."""
        for _ in range(duration_ms // 10):
            setpoint = self._commander.step(0.01)
            self._model.advance(setpoint, self._commander.flying, 10)
            self._commander.now_ms += 10
            self._commander.news.clear()

    def send(self, velocity: Vector, yaw: float = 0.0) -> None:
        """A velocity setpoint [m/s, ENU]."""
        east, north, up = velocity.tolist()
        ned = (north, east, -up)
        self._commander.receive(PositionTarget(1, VELOCITY_AND_YAW, NOTHING, ned, NOTHING, math.pi / 2 - yaw, 0.0))

    @property
    def state(self) -> tuple[Vector, Vector]:
        """Position and velocity, ENU."""
        (north, east, down), (vn, ve, vd) = self._model.body.position, self._model.body.velocity
        return np.array([east, north, -down]), np.array([ve, vn, -vd])


def random_moves(seed: int, count: int, v_max: float) -> list[tuple[float, float, float]]:
    """Displacements of up to `v_max` metres."""
    rng = np.random.default_rng(seed)
    drawn = [(v_max * rng.random(), math.asin(rng.uniform(-1, 1)), rng.uniform(0, math.tau)) for _ in range(count)]
    distance, elevation, azimuth = torch.tensor(drawn, dtype=torch.float64).T
    moves = torch.stack(spherical(distance, elevation, azimuth), dim=-1)
    return [(east, north, up) for east, north, up in moves.tolist()]


def limits_of(name: str, vehicle: Vehicle) -> tuple[Limits, Limits]:
    """Of plans and of setpoints: the defaults, tightened to the autopilot's."""
    theirs = {limit: vehicle.parameters[of] * unit for limit, (of, unit) in DIALECTS[name].limits.items()}
    vertical = {limit: theirs[limit] * VERTICAL_SHARE for limit in ("up_mps", "down_mps")}
    limits = Limits().within(**(theirs | vertical))
    speeds = ("horizontal_mps", "up_mps", "down_mps")
    headroom = {limit: min(getattr(limits, limit) * TRACKING_HEADROOM, theirs[limit]) for limit in speeds}
    return limits, limits.model_copy(update=headroom)


def envelope_of(name: str, vehicle: Vehicle, fence: Fence) -> Envelope:
    """That of a flight."""
    return Envelope(limits_of(name, vehicle)[1], fence, DIALECTS[name].reaction_s, STEP_MS / 1000, vehicle.send)


def fly(name: str, moves: list[tuple[float, float, float]], tracking: str = "position") -> Iterator[FlownSlot]:
    """Fly `moves`, one a slot, as the bridge does."""
    vehicle = Vehicle(name)
    position, _ = vehicle.state
    config = BridgeConfig(
        clock={"kind": "paced"},
        slots=len(moves),
        start_position_enu=tuple(position.tolist()),
        box={"x": (-200, 200), "y": (-200, 200), "z": (30, 120)},
    )
    envelope = envelope_of(name, vehicle, config.slot_fence)
    slots = Slots(config, limits_of(name, vehicle)[0], 0.0, position)
    step = 0
    while not slots.closed:
        time_s, (position, velocity) = step * STEP_MS / 1000, vehicle.state
        if slots.due(time_s):
            opened = slots.open(position, velocity, (0.0, 0.0, 0.0))
            if opened.flown is not None:
                yield opened.flown
            if not opened.closing:
                slots.act(action(opened.slot, moves[opened.slot]), time_s)
        slots.sample(time_s, position, velocity)
        reference = slots.reference(time_s)
        wanted = (
            follow(reference)
            if tracking == "none"
            else track(reference, position, DIALECTS[name].lead_s, DIALECTS[name].drag_share)
        )
        envelope.send(wanted, 0.0, position, velocity)
        vehicle.advance(STEP_MS)
        step += 1


def action(slot: int, displacement: tuple[float, float, float]) -> Action:
    """An action of which only the bridge's part is filled."""
    nothing: list[float] = []
    return Action(
        slot=slot,
        time_s=0.0,
        source="benchmark",
        displacement_enu=displacement,
        theta_reflection=nothing,
        split_angle=nothing,
        sign=[],
        beamforming=[],
        raw=nothing,
    )


def errors(flown: list[FlownSlot]) -> Vector:
    """Vehicle less plan at 10 Hz, shape (samples, 3)."""
    return np.array(
        [
            np.subtract(track.position_enu, plan.position_enu)
            for slot in flown
            for track, plan in zip(slot.track, slot.plan, strict=True)
        ]
    )


def rms(error: Vector) -> float:
    """Of the 3-D distance [m]."""
    return float(np.sqrt(np.mean(np.sum(np.square(error), axis=1))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--slots", type=int, default=60)
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args()
    print("autopilot   tracking  up to   RMS vs plan (each seed)          worst   goal   off at the end   limits took")
    for name in DIALECTS:
        for v_max, goal in GOALS.items():
            for tracking in ("position", "none"):
                flights = [
                    list(fly(name, random_moves(seed, options.slots, v_max), tracking))
                    for seed in range(1, options.seeds + 1)
                ]
                values = [rms(errors(flight)) for flight in flights]
                taken = np.mean(
                    [math.dist(slot.commanded_enu, slot.planned_enu) for flight in flights for slot in flight]
                )
                off = np.mean([np.linalg.norm(errors(flight)[-1]) for flight in flights])
                listed = " ".join(f"{value:5.2f}" for value in values)
                verdict = f"{goal:.1f} m" if tracking == "position" else "-"
                print(
                    f"{name:11} {tracking:9} {v_max:2.0f} m/s  {listed:31} {max(values):5.2f} m  {verdict:6}"
                    f" {off:10.2f} m   {taken:8.2f} m of {v_max / 2:.1f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
