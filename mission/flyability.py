"""What flight dynamics cost: a recorded flight in its own world, with the vehicle where it was sent, planned and flown.

Three places at the opening of each slot:

    commanded   where the plan was at the last opening, and the commanded displacement from there, all of it made within
                the slot and kept in the scenario's box: the paper's vehicle
    planned     where the slot profile has the vehicle
    flown       where it was

The commanded and the planned vehicle are level, with the heading that is asked for in their place; their power is that
of a constant velocity and of the plan. From commanded to planned is lost to limits, from planned to flown to tracking,
wind, tilt and what the envelope took from the setpoints. Users and fading are the same for all three: the world's
randomness depends on seed and slot alone.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal

import msgspec
import numpy as np
from msgspec.structs import replace

from autopilot_bridge.tracker import heading_to
from bus import topics
from bus.messages import (
    Action,
    ChannelState,
    Complex,
    FlownSlot,
    LinkReport,
    RisConfiguration,
    SlotOpened,
    TrackSample,
    Vec3,
)
from mission.flight_log import FlightLog
from mission.mission_file import Mission
from rf_model.ris_control import RisControl

if TYPE_CHECKING:
    from torch import Tensor

SAME = 1e-3
"""Relative. Another version's last digits differ (by 1e-5 once), another world's first ones."""

Reports = Mapping[int, LinkReport]
Decide = Callable[[ChannelState], Action | None]


class Places(msgspec.Struct, frozen=True):
    """A number of one slot, for the vehicle in each of the three places."""

    commanded: float
    planned: float
    flown: float


class Total(msgspec.Struct, frozen=True):
    """A number of the flight for each of the three places, and how much worse it was made on the way."""

    commanded: float
    planned: float
    flown: float
    lost_to_limits: float
    lost_to_tracking: float


class SlotWorth(msgspec.Struct, frozen=True):
    """What a slot would have been worth; the rate is that of all users."""

    rate_bps: Places
    reward: Places


class Worth(msgspec.Struct, frozen=True):
    """What the slots would have been worth: mean rate of all users, sum of the rewards."""

    rate_bps: Total
    reward: Total


class SlotFlyability(msgspec.Struct, frozen=True):
    """One slot. With `timing: pre` its rate is that of the place at its opening, to which the last displacement led."""

    slot: int
    outcome: str
    commanded_m: float
    """Length of the displacement asked for."""
    planned_m: float
    flown_m: float
    limits_m: float
    """From where it was commanded to be at the slot's end to where it was planned to be."""
    tracking_rms_m: float
    """Between plan and flight, ten times a second."""
    energy_j: Places
    as_set: SlotWorth
    anew: SlotWorth | None


class Flyability(msgspec.Struct, frozen=True):
    """Over the slots that were recorded whole and that nobody else flew."""

    difference: str
    """Why the mission's world is not that of the recording, so that nothing here can be trusted; empty when it is."""
    slots: int
    left_out: list[int]
    """Slots in which somebody else flew."""
    limits_rms_m: float
    """Over the slots' ends."""
    tracking_rms_m: float
    """Over all of the flight."""
    energy_j: Total
    as_set: Worth
    """With surface and beams as they were set in flight, which was for channels at the place flown to."""
    anew: Worth | None
    """With surface and beams set anew in each place; None where they cannot be (`scenario.sinr: amplitude`)."""
    anew_by: Literal["closed_form", "optimised"] | None
    """The mission's `ris.mode`, or the closed form where that is `agent`."""
    by_slot: list[SlotFlyability]


def flyability(log: FlightLog, mission: Mission) -> Flyability | None:
    """Evaluate a recorded flight; None when no slot was recorded whole and flown by us."""
    opened = log.by_slot(topics.SLOT)
    configurations = log.by_slot(topics.CONFIGURATION)
    recorded = log.by_slot(topics.LINK)
    flown = {slot - 1: end.flown for slot, end in opened.items() if end.flown is not None and slot - 1 in opened}
    whole = sorted(flown.keys() & configurations.keys() & recorded.keys())
    yielded_s = [state.time_s for state in log.messages(topics.STATE) if state.phase == "yielded"]
    left_out = [k for k in whole if any(opened[k].time_s <= time_s <= opened[k + 1].time_s for time_s in yielded_s)]
    slots = [k for k in whole if k not in left_out]
    if not slots:
        return None

    planned = _planned(opened, flown)
    # After a slot that somebody else flew both are where he left it: his way is no command of ours.
    commanded = _commanded(planned, {k: slot for k, slot in flown.items() if k not in left_out}, mission)
    teleports = {k: _teleport(opened[k], planned[k], commanded[k + 1], mission.scenario.slot_s) for k in flown}
    flights = (
        _moved(opened, commanded, teleports, mission),
        _moved(opened, planned, {k: slot.plan for k, slot in flown.items()}, mission),
        [opened[k] for k in sorted(opened)],
    )
    anew_by = _anew_by(mission)
    with _one_thread():
        as_set, refused = _as_set(flights, configurations, mission)
        anew = None if anew_by is None else _anew(flights, mission)
    rows = [
        SlotFlyability(
            slot=k,
            outcome=flown[k].outcome,
            commanded_m=math.hypot(*flown[k].commanded_enu),
            planned_m=math.hypot(*flown[k].planned_enu),
            flown_m=math.hypot(*flown[k].flown_enu),
            limits_m=math.dist(commanded[k + 1], planned[k + 1]),
            tracking_rms_m=_rms(_off_plan(flown[k])),
            energy_j=Places(*(reports[k].energy_j for reports in as_set)),
            as_set=_slot_worth([reports[k] for reports in as_set]),
            anew=None if anew is None else _slot_worth([reports[k] for reports in anew]),
        )
        for k in slots
    ]
    return Flyability(
        difference=refused or _difference(recorded, as_set[-1]),
        slots=len(slots),
        left_out=left_out,
        limits_rms_m=_rms([row.limits_m for row in rows]),
        tracking_rms_m=_rms([off for k in slots for off in _off_plan(flown[k])]),
        energy_j=_total([row.energy_j for row in rows], better=-1),
        as_set=_worth([row.as_set for row in rows]),
        anew=None if anew is None else _worth([row.anew for row in rows if row.anew is not None]),
        anew_by=anew_by,
        by_slot=rows,
    )


# Where the vehicle is at each slot's opening, by slot.


def _planned(opened: Mapping[int, SlotOpened], flown: Mapping[int, FlownSlot]) -> dict[int, Vec3]:
    """The plan as it was sampled at the slot's opening, as the flown position was; else the end of the one before."""
    places: dict[int, Vec3] = {}
    for k in sorted(opened):
        if k in flown and flown[k].plan:
            places[k] = flown[k].plan[0].position_enu
        elif k - 1 in flown:
            places[k] = _sum(places[k - 1], flown[k - 1].planned_enu)
        else:
            places[k] = opened[k].position_enu
    return places


def _commanded(planned: Mapping[int, Vec3], flown: Mapping[int, FlownSlot], mission: Mission) -> dict[int, Vec3]:
    low, high = np.array(mission.scenario.box_enu).T
    places = dict(planned)
    for k, slot in flown.items():
        east, north, up = np.clip(_sum(planned[k], slot.commanded_enu), low, high).tolist()
        places[k + 1] = east, north, up
    return places


def _teleport(opening: SlotOpened, start: Vec3, end: Vec3, slot_s: float) -> list[TrackSample]:
    """From start to end at one velocity."""
    east, north, up = ((b - a) / slot_s for a, b in zip(start, end, strict=True))
    return [
        TrackSample(time_s=time_s, position_enu=place, velocity_enu=(east, north, up))
        for time_s, place in ((opening.time_s, start), (opening.time_s + slot_s, end))
    ]


def _moved(
    opened: Mapping[int, SlotOpened],
    places: Mapping[int, Vec3],
    tracks: Mapping[int, list[TrackSample]],
    mission: Mission,
) -> list[SlotOpened]:
    """The openings with the vehicle level in other places, and other tracks of it between them."""
    moved = []
    yaw = mission.scenario.panel_heading_rad
    for k in sorted(opened):
        if mission.yaw == "face_users":
            yaw = heading_to(mission.scenario.user_centre_enu, np.array(places[k]), yaw)
        flown = opened[k].flown
        moved.append(
            replace(
                opened[k],
                position_enu=places[k],
                attitude_rad=(0.0, 0.0, yaw),
                flown=replace(flown, track=tracks[k - 1]) if flown is not None and k - 1 in tracks else flown,
            )
        )
    return moved


# What the slots are worth there.


@contextmanager
def _one_thread() -> Iterator[None]:
    """The tensors of a slot are small: on a busy machine more threads took 24 s for what one does in one."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _as_set(
    flights: Sequence[Sequence[SlotOpened]], configurations: Mapping[int, RisConfiguration], mission: Mission
) -> tuple[list[Reports], str]:
    """With the configurations in force in the flight, and why one of them was refused."""

    def in_force(state: ChannelState) -> Action | None:
        configuration = configurations.get(state.slot)
        return None if configuration is None else _repeated(configuration, mission)

    evaluated = [_evaluated(flight, mission, RisControl(), in_force) for flight in flights]
    return [reports for reports, _ in evaluated], next((why for _, refused in evaluated for why in refused), "")


def _anew_by(mission: Mission) -> Literal["closed_form", "optimised"] | None:
    if mission.ris.mode != "agent":
        return mission.ris.mode
    return "closed_form" if mission.scenario.sinr == "power" else None


def _anew(flights: Sequence[Sequence[SlotOpened]], mission: Mission) -> list[Reports]:
    """With surface and beams set from what is known of the channels in each place."""
    if mission.ris.by_itself:
        return [_evaluated(flight, mission, mission.ris, lambda _: None)[0] for flight in flights]
    return [_evaluated(flight, mission, RisControl(), lambda state: _aligned(state, mission))[0] for flight in flights]


def _evaluated(
    flight: Sequence[SlotOpened], mission: Mission, ris: RisControl, decide: Decide
) -> tuple[Reports, list[str]]:
    """A flight in its world, where surface and beams are set as decided; and what was refused."""
    from rf_model.slot_radio import SlotRadio  # torch takes a second to import

    radio = SlotRadio(mission.scenario, mission.seed, ris)
    reports: dict[int, LinkReport] = {}
    for opened in flight:
        for message in radio.open(opened):
            if isinstance(message, LinkReport):
                reports[message.slot] = message
            elif isinstance(message, ChannelState) and (action := decide(message)) is not None:
                radio.apply(action)
    return reports, radio.rejections


def _repeated(configuration: RisConfiguration, mission: Mission) -> Action:
    """The action that sets a configuration."""
    free = mission.scenario.surface == "independent"  # of all others theta_transmission follows from the rest
    return Action(
        slot=configuration.slot,
        time_s=configuration.time_s,
        source="recorded",
        displacement_enu=(0.0, 0.0, 0.0),
        theta_reflection=configuration.theta_reflection,
        split_angle=configuration.split_angle,
        sign=configuration.sign,
        beamforming=configuration.beamforming,
        raw=[],
        theta_transmission=configuration.theta_transmission if free else [],
    )


def _aligned(state: ChannelState, mission: Mission) -> Action | None:
    """The action that sets the closed form for the channels observed."""
    import torch

    from rf_model.channels import Channels
    from rf_model.reference.uncompiled import closed_form

    def matrix(rows: list[list[Complex]]) -> "Tensor":
        return torch.view_as_complex(torch.tensor(rows, dtype=torch.float64))

    known = Channels(
        direct=matrix(state.direct),
        bs_ris=matrix(state.bs_ris),
        ris_user=matrix(state.ris_user),
        transmission=torch.tensor([region == "transmission" for region in state.regions]),
    )
    if not all(torch.isfinite(torch.view_as_real(link)).all() for link in (known.direct, known.bs_ris, known.ris_user)):
        return None  # as the agent, which is told nothing of such channels
    trc, beamforming = closed_form(mission.scenario, known)
    return Action(
        slot=state.slot,
        time_s=state.time_s,
        source="closed_form",
        displacement_enu=(0.0, 0.0, 0.0),
        theta_reflection=trc.theta_reflection.tolist(),
        split_angle=trc.split_angle.tolist(),
        sign=[1 if sign > 0 else -1 for sign in trc.sign.tolist()],
        beamforming=[[(re, im) for re, im in row] for row in torch.view_as_real(beamforming).tolist()],
        raw=[],
        theta_transmission=trc.theta_transmission.tolist() if mission.scenario.surface == "independent" else [],
    )


def _difference(recorded: Reports, again: Reports) -> str:
    """The first number that does not come out as recorded."""
    for k in sorted(recorded.keys() & again.keys()):
        before, now = _told(recorded[k]), _told(again[k])
        for what in before:
            if not math.isclose(before[what], now[what], rel_tol=SAME):  # "users" comes first
                return f"slot {k} was recorded with {what} {before[what]:.4g}, this mission makes it {now[what]:.4g}"
    return ""


def _told(report: LinkReport) -> dict[str, float]:
    rates = {f"user {user}'s kbit/s": rate / 1e3 for user, rate in enumerate(report.rate_bps)}
    return {"users": len(report.rate_bps), **rates, "energy in J": report.energy_j}


# Numbers of slots and flights.


def _off_plan(flown: FlownSlot) -> list[float]:
    """How far the vehicle was from its plan at the times of the track [m]."""
    return [math.dist(a.position_enu, b.position_enu) for a, b in zip(flown.track, flown.plan, strict=False)]


def _slot_worth(reports: Sequence[LinkReport]) -> SlotWorth:
    return SlotWorth(
        rate_bps=Places(*(report.sum_rate_bps for report in reports)),
        reward=Places(*(report.reward for report in reports)),
    )


def _worth(slots: Sequence[SlotWorth]) -> Worth:
    return Worth(
        rate_bps=_total([slot.rate_bps for slot in slots], share=1 / len(slots)),
        reward=_total([slot.reward for slot in slots]),
    )


def _total(slots: Sequence[Places], share: float = 1.0, better: Literal[1, -1] = 1) -> Total:
    """`share` of the sum; `better` is the direction in which a number is."""
    commanded, planned, flown = (
        share * math.fsum(values)
        for values in zip(*((slot.commanded, slot.planned, slot.flown) for slot in slots), strict=True)
    )
    return Total(
        commanded=commanded,
        planned=planned,
        flown=flown,
        lost_to_limits=better * (commanded - planned),
        lost_to_tracking=better * (planned - flown),
    )


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(math.fsum(value * value for value in values) / len(values)) if values else 0.0


def _sum(place: Vec3, displacement: Vec3) -> Vec3:
    east, north, up = (a + b for a, b in zip(place, displacement, strict=True))
    return east, north, up
