"""Everything that travels on the bus, as msgspec structs (JSON on the wire).

Frames are ENU metres about the home position held since arming; units are SI. Times are vehicle time in seconds
(the autopilot's clock) unless a name says `wall`. Unknown fields are ignored; missing, mistyped or non-finite ones
make `bus.topics` refuse the message and count it.

Shapes: N elements, M antennas, J users; a complex number is `[re, im]`.
"""

from typing import Annotated, Literal

import msgspec

Finite = Annotated[float, msgspec.Meta(ge=-1.7976931348623157e308, le=1.7976931348623157e308)]
Age = Annotated[float, msgspec.Meta(ge=0, le=1.7976931348623157e308)]
Count = Annotated[int, msgspec.Meta(ge=0)]
Vec3 = tuple[Finite, Finite, Finite]
Complex = tuple[Finite, Finite]
Sign = Literal[-1, 1]
Region = Literal["reflection", "transmission"]
SlotOutcome = Literal["flown", "clipped", "late", "missing", "rejected"]
ConfigurationSource = Literal["action", "held", "default", "closed_form", "optimised"]
"""The slot's action; the last configuration again, or the neutral one; or the rf node by itself, and how."""


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """Base of all messages."""


class VehicleState(Message, frozen=True):
    """Where the vehicle is; 10 to 50 Hz, only the newest is kept (display, supervision)."""

    time_s: Finite
    position_enu: Vec3
    velocity_enu: Vec3
    attitude_rad: Vec3
    """Roll and pitch as MAVLink's ATTITUDE; yaw in ENU: 0 faces east, counter-clockwise."""
    mode: str
    armed: bool
    landed: bool
    battery_remaining: Annotated[float, msgspec.Meta(ge=0, le=1)] | None
    home_lat_lon_alt: Vec3 | None
    """Degrees, degrees, metres above mean sea level: what the ENU origin is on the globe."""
    phase: str
    """The bridge's phase: see `autopilot_bridge.node`."""
    position_age_s: Age = 0.0
    """How old position and velocity are at `time_s`, beyond the 0.1 s over which they are carried on."""
    stop_enu: Vec3 | None = None
    """Where it comes to rest if it brakes now, as its own bridge's envelope has it; None while it is not armed."""


class TrackSample(Message, frozen=True):
    """One point of the flown track (10 Hz)."""

    time_s: Finite
    position_enu: Vec3
    velocity_enu: Vec3


class FlownSlot(Message, frozen=True):
    """What became of a slot's action in the air."""

    slot: Count
    outcome: SlotOutcome
    reasons: list[str]
    """What kept it from being flown as commanded; `acceleration` alone is no clipping, only how far a slot reaches."""
    commanded_enu: Vec3
    """Displacement asked for [m]; zero when no action was executed."""
    planned_enu: Vec3
    """Displacement of the slot profile after limits and envelope [m]."""
    flown_enu: Vec3
    """Displacement flown between the openings of this slot and the next [m]."""
    track: list[TrackSample]
    plan: list[TrackSample]
    """The slot profile's reference at the track's times."""


class SlotOpened(Message, frozen=True):
    """A slot opens: the bridge's clock tick for radio and agent.

    The last one (`closing`) only closes the slot before it: nobody answers it with an action.
    """

    slot: Count
    slots: Count
    time_s: Finite
    position_enu: Vec3
    velocity_enu: Vec3
    attitude_rad: Vec3
    closing: bool
    flown: FlownSlot | None
    """The slot that just ended; None at slot 0."""


class ChannelState(Message, frozen=True):
    """The channels at a slot's opening: what the agent observes (paper eq. 22)."""

    slot: Count
    time_s: Finite
    position_enu: Vec3
    attitude_rad: Vec3
    users_enu: list[Vec3]
    regions: list[Region]
    direct: list[list[Complex]]
    """h_b, J x M."""
    bs_ris: list[list[Complex]]
    """H, N x M."""
    ris_user: list[list[Complex]]
    """h_s, J x N."""


class Action(Message, frozen=True):
    """Physical, already decoded decision for one slot; consumers validate, they never decode again."""

    slot: Count
    time_s: Finite
    source: str
    """Who decided, e.g. a checkpoint's name."""
    displacement_enu: Vec3
    theta_reflection: list[Finite]
    """N phases in [-pi, pi]."""
    split_angle: list[Finite]
    """N angles x in [0, pi/2]: beta_R = sin x, beta_T = cos x."""
    sign: list[Sign]
    """N signs: theta_T = wrap(theta_R + sign * pi/2)."""
    beamforming: list[list[Complex]]
    """W, M x J [sqrt(W)]."""
    raw: list[Finite]
    """The actors' output before decoding, for data sets; may be empty."""
    theta_transmission: list[Finite] = []
    """N phases in [-pi, pi] for a surface whose phases are independent; empty for every other."""


class Setpoint(Message, frozen=True):
    """A velocity setpoint as it went to the autopilot (SET_POSITION_TARGET_LOCAL_NED), and where it came from."""

    time_s: Finite
    """When it was sent."""
    slot: Count | None
    """The open slot; None while there is none."""
    source: str
    """What is being flown: an action's `source`, or `transit`, or `hold`."""
    action_slot: Count | None
    """The slot whose action is being flown: up to the action's coming the last slot's; None when none is."""
    action_age_s: Age | None
    """Since that action was taken in."""
    state_age_s: Age
    """Since the position that this was computed from."""
    wanted_enu: Vec3 | None
    """Velocity that tracking asked for [m/s]; None when it was not finite."""
    velocity_enu: Vec3
    """Velocity sent [m/s]."""
    yaw_rad: Finite
    """ENU."""
    reasons: list[str]
    """Why what was sent is not what was wanted: speed, acceleration, fence, energy, separation..."""


class RisConfiguration(Message, frozen=True):
    """The coefficients and beamforming in force in a slot (paper eq. 1, 2)."""

    slot: Count
    time_s: Finite
    source: ConfigurationSource
    theta_reflection: list[Finite]
    theta_transmission: list[Finite]
    beta_reflection: list[Finite]
    beta_transmission: list[Finite]
    sign: list[Sign]
    split_angle: list[Finite]
    beamforming: list[list[Complex]]


class LinkReport(Message, frozen=True):
    """What a slot was worth; published when the next slot opens."""

    slot: Count
    time_s: Finite
    configuration: ConfigurationSource
    position_enu: Vec3
    users_enu: list[Vec3]
    regions: list[Region]
    sinr: list[Finite]
    rate_bps: list[Finite]
    sum_rate_bps: Finite
    fair_rate_bps: Finite
    hfi: Finite
    jfi: Finite
    qos_bps: Finite
    below_qos: list[bool]
    power_w: Finite
    """Mean over the flown track."""
    energy_j: Finite
    reward: Finite


CommandName = Literal["start", "hold", "resume", "return", "land"]


class Command(Message, frozen=True):
    """A request to the bridge (the only one in the system)."""

    name: CommandName


class CommandReply(Message, frozen=True):
    """The bridge's answer; `reason` says why not."""

    accepted: bool
    reason: str


class MissionEvent(Message, frozen=True):
    """A fact of the flight worth a line in the log."""

    time_s: Finite
    source: str
    kind: str
    """E.g. phase, statustext, failsafe, node_lost, node_back, ended, error."""
    text: str
    exit_code: Count | None = None
    """Set on the bridge's last event (`kind == "ended"`): 0 as planned, 3 by failsafe, 1 error."""


class NodeHealth(Message, frozen=True):
    """Counters of a node, at 1 Hz wall clock and once at its end."""

    node: str
    wall_time_s: Finite
    counters: dict[str, Count]
