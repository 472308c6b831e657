"""The radio world slot by slot: messages in, messages out. No bus, no clock, no global randomness.

Everything random in slot k comes from generators seeded by (seed, k), so that a restarted node, or a replay, sees the
same users and channels. All in double precision.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from bus.messages import (
    Action,
    ChannelState,
    Complex,
    ConfigurationSource,
    FlownSlot,
    LinkReport,
    Message,
    Region,
    RisConfiguration,
    Sign,
    SlotOpened,
    TrackSample,
    Vec3,
)
from rf_model.channels import Channels, draw_fading, faded_channels
from rf_model.csi import Observed
from rf_model.geometry import panel_frame
from rf_model.link import BeamformingError, check_beamforming, identity_beamforming
from rf_model.mobility import Users, initial_users, move_users
from rf_model.reference.solve import ReferenceInputError
from rf_model.reward import reward
from rf_model.ris_control import RisControl, reference_solution
from rf_model.scenario import Scenario
from rf_model.seeding import generator_of
from rf_model.star_ris import Coefficients, TrcError
from rf_model.surfaces import read_coefficients, surface_of
from rf_model.world import slot_power, slot_rates, track_power

AGENT = RisControl()
_USERS, _CHANNELS, _ESTIMATES = 0, 1, 2


@dataclass(frozen=True)
class _Decision:
    """What the surface and the base station are set to."""

    trc: Coefficients
    beamforming: Tensor


@dataclass(frozen=True)
class _OpenSlot:
    opened: SlotOpened
    users: Users
    channels: Channels
    observed: Channels
    """What is known of them."""


class SlotRadio:
    """One vehicle's radio world.

    `open` (or `opening`) takes each `SlotOpened` and `apply` each `Action`; both return the messages to publish, in
    order. In every slot exactly one `RisConfiguration` and one `LinkReport` come out, whatever goes in. `counters` says
    what happened: slots, flights, repeated_slots and lost_slots; applied, held, default, closed_form and optimised
    (together one a slot); rejected, stray, doubtful (seemed late) and late (was, by the bridge's word); unsolved.

    When `ris` has the surface set without the agent, that happens as the slot opens, and every action is stray. Raises
    RisControlError when the scenario does not allow it.
    """

    def __init__(self, scenario: Scenario, seed: int, ris: RisControl = AGENT) -> None:
        ris.require_fit(scenario)
        self.counters: Counter[str] = Counter()
        self.rejections: list[str] = []
        """Why what should have been set was not, one line each, oldest first; whoever reports them clears the list."""
        self._scenario = scenario
        self._ris = ris
        self._seed = seed
        self._neutral = _Decision(
            surface_of(scenario).neutral(torch.float64), identity_beamforming(scenario, torch.complex128)
        )
        self._decision = self._neutral
        self._ever_applied = False
        self._slot: _OpenSlot | None = None
        self._settled: ConfigurationSource | None = None
        self._doubtful: Action | None = None
        self._walked: tuple[int, Users] | None = None
        self._observed = Observed(scenario)
        self._time_s = 0.0

    @property
    def needs_actions(self) -> bool:
        """Whether the surface is set by actions."""
        return not self._ris.by_itself

    @property
    def slot(self) -> SlotOpened | None:
        """The slot now open."""
        return None if self._slot is None else self._slot.opened

    @property
    def time_s(self) -> float:
        """Vehicle time at the newest opening (closing ones included); 0 before any."""
        return self._time_s

    def must_wait(self, opened: SlotOpened) -> bool:
        """Whether the open slot's action is still on its way although the next slot opens.

        So it is when the bridge says that it got one in time: the two come over different links.
        """
        return (
            self._slot is not None
            and self._settled is None
            and self._doubtful is None
            and _came_in_time(self._slot.opened.slot, opened)
        )

    def open(self, opened: SlotOpened) -> list[Message]:
        """Close the open slot (its configuration, if still due, and its report), then open this one.

        Of the new slot come its configuration, when that needs no action, and its channels.
        """
        return list(self.opening(opened))

    @torch.inference_mode()
    def opening(self, opened: SlotOpened) -> Iterator[Message]:
        """`open`, message by message as soon as each is known; to be taken to its end before anything else."""
        self._time_s = opened.time_s
        if self._slot is not None:
            before = self._slot.opened
            if opened.slot == before.slot and opened.time_s == before.time_s:
                self.counters["repeated_slots"] += 1
                return
            if opened.slot <= before.slot:
                self._forget_flight()
        slot = None if opened.closing and self._scenario.timing == "pre" else self._opened(opened)
        if self._slot is not None:
            self.counters["lost_slots"] += opened.slot - self._slot.opened.slot - 1
            if self._settled is None:
                yield self._settle_overdue(self._slot, opened)
            yield self._report(self._slot, opened, self._slot if self._scenario.timing == "pre" else slot)
        if opened.closing:
            self._forget_flight()
            return
        assert slot is not None
        self._slot = slot
        self._settled = None
        self._doubtful = None
        self.counters["slots"] += 1
        if self._ris.mode != "agent":
            yield self._set_by_itself(slot, self._ris.mode)
        yield _channel_state(slot)

    @torch.inference_mode()
    def apply(self, action: Action, late: bool = False) -> list[Message]:
        """Check the open slot's action and set it, or keep what is set when it is bad.

        One that seems `late` is put by: the next `SlotOpened` says whether the bridge got it in time. Actions of other
        slots and second ones are counted as stray and change nothing.
        """
        if (
            self._slot is None
            or self._settled is not None
            or self._doubtful is not None
            or action.slot != self._slot.opened.slot
        ):
            self.counters["stray"] += 1
            return []
        if late:
            self._doubtful = action
            self.counters["doubtful"] += 1
            return []
        return [self._set(self._slot, action)]

    def _settle_overdue(self, slot: _OpenSlot, next_opened: SlotOpened) -> RisConfiguration:
        if self._doubtful is not None:
            if _came_in_time(slot.opened.slot, next_opened):
                return self._set(slot, self._doubtful)
            self.counters["late"] += 1
        return self._keep(slot)

    def _set(self, slot: _OpenSlot, action: Action) -> RisConfiguration:
        try:
            self._decision = self._read(action)
        except (TrcError, BeamformingError) as error:
            self.counters["rejected"] += 1
            self.rejections.append(f"action of slot {action.slot}: {error}")
            return self._keep(slot)
        self._ever_applied = True
        return self._settle(slot, "action", "applied")

    def _set_by_itself(self, slot: _OpenSlot, mode: Literal["closed_form", "optimised"]) -> RisConfiguration:
        """From what is known of the slot's channels; checked as an action is."""
        try:
            solution = reference_solution(self._scenario, self._ris, slot.observed)
            decision = _Decision(solution.trc, solution.beamforming)
            surface_of(self._scenario).check(decision.trc)
            check_beamforming(decision.beamforming, self._scenario)
        except (ReferenceInputError, TrcError, BeamformingError) as error:
            self.counters["unsolved"] += 1
            self.rejections.append(f"{mode} of slot {slot.opened.slot}: {error}")
            return self._keep(slot)
        self._decision = decision
        self._ever_applied = True
        return self._settle(slot, mode, mode)

    def _keep(self, slot: _OpenSlot) -> RisConfiguration:
        kept: ConfigurationSource = "held" if self._ever_applied else "default"
        return self._settle(slot, kept, kept)

    def _settle(self, slot: _OpenSlot, source: ConfigurationSource, counter: str) -> RisConfiguration:
        self._settled = source
        self.counters[counter] += 1
        return _configuration(slot.opened, source, self._decision)

    def _opened(self, opened: SlotOpened) -> _OpenSlot:
        users = self._users_of(opened.slot)
        position = torch.tensor(opened.position_enu, dtype=torch.float64)
        roll, pitch, yaw = torch.tensor(opened.attitude_rad, dtype=torch.float64)
        frame = panel_frame(yaw) if self._scenario.attitude == "level" else panel_frame(yaw, roll, pitch)
        fading = draw_fading(self._scenario, (), generator_of(self._seed, opened.slot, _CHANNELS), torch.float64)
        channels = faded_channels(self._scenario, position, frame, users.position_enu, fading)
        observed = self._observed.of(channels, generator_of(self._seed, opened.slot, _ESTIMATES))
        return _OpenSlot(opened, users, channels, observed)

    def _report(self, slot: _OpenSlot, next_opened: SlotOpened, rated: _OpenSlot | None) -> LinkReport:
        """What `slot` was worth in the channels of the slot `rated`."""
        assert self._settled is not None
        assert rated is not None
        rates = slot_rates(self._scenario, rated.channels, self._decision.trc, self._decision.beamforming)
        power = self._mean_power(slot.opened, next_opened)
        following = next_opened.slot == slot.opened.slot + 1 and next_opened.time_s > slot.opened.time_s
        duration_s = next_opened.time_s - slot.opened.time_s if following else self._scenario.slot_s
        return LinkReport(
            slot=slot.opened.slot,
            time_s=slot.opened.time_s,
            configuration=self._settled,
            position_enu=rated.opened.position_enu,
            users_enu=_points(rated.users.position_enu),
            regions=_regions(rated.channels),
            sinr=rates.sinr.tolist(),
            rate_bps=rates.rate_bps.tolist(),
            sum_rate_bps=rates.sum_rate_bps.item(),
            fair_rate_bps=rates.fair_rate_bps.item(),
            hfi=rates.hfi.item(),
            jfi=rates.jfi.item(),
            qos_bps=self._scenario.qos_bps,
            below_qos=(rates.rate_bps < self._scenario.qos_bps).tolist(),
            power_w=power.item(),
            energy_j=power.item() * duration_s,
            reward=reward(self._scenario, rates.fair_rate_bps, power).item(),
        )

    def _mean_power(self, opened: SlotOpened, next_opened: SlotOpened) -> Tensor:
        """Mean over the flown track, or over both openings when the bridge reports none for this slot [W]."""
        track = _track_of(next_opened.flown, opened.slot)
        yaw = torch.tensor(opened.attitude_rad[2], dtype=torch.float64)
        if len(track) < 2 or track[-1].time_s <= track[0].time_s:
            ends = [sample.velocity_enu for sample in track] or [opened.velocity_enu, next_opened.velocity_enu]
            return slot_power(self._scenario, torch.tensor(ends, dtype=torch.float64), yaw).mean()
        time_s = torch.tensor([sample.time_s for sample in track], dtype=torch.float64)
        velocity = torch.tensor([sample.velocity_enu for sample in track], dtype=torch.float64)
        return track_power(self._scenario, time_s, velocity, yaw)

    def _read(self, action: Action) -> _Decision:
        trc = read_coefficients(
            self._scenario,
            theta_reflection=torch.tensor(action.theta_reflection, dtype=torch.float64),
            split_angle=torch.tensor(action.split_angle, dtype=torch.float64),
            sign=torch.tensor(action.sign, dtype=torch.float64),
            theta_transmission=torch.tensor(action.theta_transmission, dtype=torch.float64),
        )
        J, M = self._scenario.users, self._scenario.antennas
        widths = {len(row) for row in action.beamforming}
        if len(action.beamforming) != M or widths != {J}:
            columns = "/".join(str(width) for width in sorted(widths)) or "0"
            raise BeamformingError(f"beamforming: {len(action.beamforming)} x {columns}, must be M x J = {M} x {J}")
        beamforming = torch.view_as_complex(torch.tensor(action.beamforming, dtype=torch.float64))
        check_beamforming(beamforming, self._scenario)
        return _Decision(trc, beamforming)

    def _users_of(self, slot: int) -> Users:
        """Users of a slot, walked there from slot 0: the same whenever this node was started."""
        if self._walked is None or self._walked[0] > slot:
            self._walked = (0, initial_users(self._scenario, (), generator_of(self._seed, 0, _USERS), torch.float64))
        walked, users = self._walked
        for step in range(walked + 1, slot + 1):
            users = move_users(self._scenario, users, generator_of(self._seed, step, _USERS))
        self._walked = (slot, users)
        return users

    def _forget_flight(self) -> None:
        """What was set does not outlive the flight."""
        self.counters["flights"] += 1
        self._slot = None
        self._settled = None
        self._doubtful = None
        self._decision = self._neutral
        self._ever_applied = False
        self._observed.forget()


def rehearse(scenario: Scenario, ris: RisControl) -> None:
    """Open two slots of a throwaway world, so that what is compiled or loaded at first use is there before a flight.

    The first time on a machine the reference compiles for 15 to 30 s.
    """
    radio = SlotRadio(scenario, 0, ris)
    for slot in range(2):
        radio.open(
            SlotOpened(
                slot=slot,
                slots=2,
                time_s=slot * scenario.slot_s,
                position_enu=scenario.start_enu,
                velocity_enu=(0.0, 0.0, 0.0),
                attitude_rad=(0.0, 0.0, scenario.panel_heading_rad),
                closing=False,
                flown=None,
            )
        )


def _came_in_time(slot: int, next_opened: SlotOpened) -> bool:
    flown = next_opened.flown
    return flown is not None and flown.slot == slot and flown.outcome not in ("missing", "late")


def _track_of(flown: FlownSlot | None, slot: int) -> Sequence[TrackSample]:
    return flown.track if flown is not None and flown.slot == slot else ()


def _channel_state(slot: _OpenSlot) -> ChannelState:
    return ChannelState(
        slot=slot.opened.slot,
        time_s=slot.opened.time_s,
        position_enu=slot.opened.position_enu,
        attitude_rad=slot.opened.attitude_rad,
        users_enu=_points(slot.users.position_enu),
        regions=_regions(slot.channels),
        direct=_matrix(slot.observed.direct),
        bs_ris=_matrix(slot.observed.bs_ris),
        ris_user=_matrix(slot.observed.ris_user),
    )


def _configuration(opened: SlotOpened, source: ConfigurationSource, decision: _Decision) -> RisConfiguration:
    trc = decision.trc
    signs: list[Sign] = [1 if sign > 0 else -1 for sign in trc.sign.tolist()]
    return RisConfiguration(
        slot=opened.slot,
        time_s=opened.time_s,
        source=source,
        theta_reflection=trc.theta_reflection.tolist(),
        theta_transmission=trc.theta_transmission.tolist(),
        beta_reflection=trc.beta_reflection.tolist(),
        beta_transmission=trc.beta_transmission.tolist(),
        sign=signs,
        split_angle=trc.split_angle.tolist(),
        beamforming=_matrix(decision.beamforming),
    )


def _points(positions: Tensor) -> list[Vec3]:
    return [(x, y, z) for x, y, z in positions.tolist()]


def _regions(channels: Channels) -> list[Region]:
    return ["transmission" if beyond else "reflection" for beyond in channels.transmission.tolist()]


def _matrix(matrix: Tensor) -> list[list[Complex]]:
    return [[(re, im) for re, im in row] for row in torch.view_as_real(matrix).tolist()]
