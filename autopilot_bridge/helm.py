"""The helm: what is tracked becomes velocity setpoints, through the envelope, each one told on the bus."""

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from airframe.slot_profile import Reference, SlotProfile, Vector
from autopilot_bridge.clock import Clock
from autopilot_bridge.config import BridgeConfig
from autopilot_bridge.energy import Endurance
from autopilot_bridge.envelope import Envelope, Sent
from autopilot_bridge.fence import Fence, lowered
from autopilot_bridge.ground import Ground
from autopilot_bridge.preflight import Bounds, unbound
from autopilot_bridge.separation import Track
from autopilot_bridge.slots import Slots, vec3
from autopilot_bridge.tracker import follow, heading_to, track
from autopilot_bridge.transit import Transit
from autopilot_bridge.vehicle import Vehicle
from bus import messages as m

TELLING = ("fence", "altitude", "home distance", "energy", "separation", "not finite")
"""Clips of setpoints that change what becomes of an action; the others only slow the tracking."""


class Helm:
    """Steers one vehicle.

    `others()` tells where the vehicles are that this one must keep apart from; `may_send()` whether a setpoint may go
    out at this very instant.
    """

    def __init__(
        self,
        config: BridgeConfig,
        clock: Clock,
        vehicle: Vehicle,
        ground: Ground,
        others: Callable[[], Sequence[Track]],
        may_send: Callable[[], bool],
    ) -> None:
        self._config, self._clock, self._vehicle, self._ground, self._others = config, clock, vehicle, ground, others
        self._may_send = may_send
        self._sent = False
        """Whether the last setpoint went out."""
        self._place: tuple[Vector, Vector] | None = None
        """The last that was told."""
        self._guide: Callable[[float], Reference] | None = None
        """Vehicle time -> what to track; None: no setpoints at all."""
        self._source = "hold"
        """What the guide is called while no action is flown."""
        self._yaw = config.panel_heading_rad
        """The last heading asked for [rad, ENU]."""
        self._bounds = unbound(config)
        self._envelopes: dict[bool, Envelope] = {}
        """In the slots, and on the way there; as they are needed."""
        self.slots: Slots | None = None
        self.counters: Counter[str] = Counter()

    @property
    def steering(self) -> bool:
        """Whether setpoints are to be sent."""
        return self._guide is not None

    @property
    def bounds(self) -> Bounds:
        return self._bounds

    def stay_within(self, bounds: Bounds) -> None:
        """The autopilot's limits are known."""
        self._bounds, self._envelopes = bounds, {}

    def follow(self, way: SlotProfile | Transit, source: str = "hold") -> None:
        """Track `way`, which starts now."""
        since_s = self._clock.now
        self._guide, self._source = lambda time_s: way.at(time_s - since_s), source

    def follow_slots(self, slots: Slots) -> None:
        """Track what the slots are flown by."""
        self.slots, self._guide, self._source = slots, slots.reference, "hold"

    def let_go(self) -> None:
        """No setpoints."""
        self._guide = None

    def here(self) -> tuple[Vector, Vector]:
        """Position and velocity now, or the last that were told. Raises VehicleError when there were none."""
        telemetry = self._vehicle.telemetry
        if telemetry.position_enu is not None or self._place is None:
            self._place = telemetry.at(self._clock.now)
        return self._place

    @property
    def fence(self) -> Fence:
        """What the vehicle must not leave now."""
        return self._envelope.fence

    def left_j(self, endurance: Endurance) -> float:
        """What the battery holds [J] before the autopilot comes down by itself."""
        battery = self._vehicle.telemetry.battery_remaining
        return endurance.left_j(None if battery is None else battery - self._bounds.battery_reserve)

    def stop(self, position: Vector, velocity: Vector) -> Vector:
        """Where the vehicle could come to rest."""
        return self._envelope.stop(position, velocity)

    def steer(self) -> None:
        """One setpoint, if any is to be sent."""
        if self._guide is None or not self._may_send():
            return
        position, velocity = self.here()
        reference = self._guide(self._clock.now)
        if self._config.tracking == "none" and self.slots is not None:
            wanted = follow(reference)
        else:
            wanted = track(reference, position, self._vehicle.dialect.lead_s, self._vehicle.dialect.drag_share)
        endurance = self._config.endurance
        energy_j = None if endurance is None else self.left_j(endurance)
        sent = self._envelope.send(wanted, self._heading(position), position, velocity, self._others(), energy_j)
        if not self._sent:
            return
        self.counters["setpoints"] += 1
        self._log(wanted, sent)
        for reason in sent.reasons:
            self.counters[f"setpoints_clipped_{reason.replace(' ', '_')}"] += 1
            if self.slots is not None and reason in TELLING:
                self.slots.clipped(f"envelope: {reason}")

    def _log(self, wanted: Vector, sent: Sent) -> None:
        """The proof of what was sent and why."""
        slots, now = self.slots, self._clock.now
        order = None if slots is None else slots.order
        self._ground.setpoint.send(
            m.Setpoint(
                time_s=now,
                slot=None if slots is None or slots.number < 0 or slots.closed else slots.number,
                source=order.source if order else self._source,
                action_slot=order.slot if order else None,
                action_age_s=max(0.0, now - order.taken_s) if order else None,
                state_age_s=max(0.0, now - self._vehicle.telemetry.position_s),
                wanted_enu=vec3(wanted) if np.isfinite(wanted).all() else None,
                velocity_enu=vec3(sent.velocity),
                yaw_rad=self._yaw,
                reasons=list(sent.reasons),
            )
        )

    @property
    def _envelope(self) -> Envelope:
        in_slots = self.slots is not None
        if in_slots not in self._envelopes:
            fence = self._config.slot_fence if in_slots else self._config.flight_fence
            self._envelopes[in_slots] = Envelope(
                self._bounds.tracking,
                lowered(fence, self._bounds.ceiling_m),
                self._vehicle.dialect.reaction_s,
                self._config.tick_ms / 1000,
                self._transmit,
                self._bounds.home_distance_m,
                self._config.endurance,
                self._config.separation_m,
            )
        return self._envelopes[in_slots]

    def _transmit(self, velocity: Vector, yaw: float) -> None:
        """Asks once more: whatever came before may have taken long."""
        self._sent = self._may_send()
        if self._sent:
            self._vehicle.send_velocity(velocity, yaw)

    def _heading(self, position: Vector) -> float:
        """Yaw to fly [rad, ENU]."""
        if self._config.face_enu is not None:
            self._yaw = heading_to(self._config.face_enu, position, self._yaw)
        return self._yaw
