"""The loop closed without an autopilot: many worlds side by side as tensors, for training."""

from dataclasses import dataclass

import torch
from torch import Tensor

from agent.decoding import PhysicalAction, decode
from agent.inertia import reachable
from agent.observation import Normalisation, observe
from rf_model.channels import Channels, draw_channels
from rf_model.mobility import Users, initial_users, move_users
from rf_model.reward import reward
from rf_model.scenario import Scenario
from rf_model.star_ris import Trc
from rf_model.world import Rates, slot_power, slot_rates


@dataclass(frozen=True)
class World:
    """B worlds at the opening of a slot."""

    position_enu: Tensor
    """Vehicle [B, 3] m."""
    velocity_enu: Tensor
    """[B, 3] m/s; always zero without inertia."""
    users: Users
    channels: Channels


@dataclass(frozen=True)
class Step:
    """What a slot brought to each of B worlds."""

    observation: Tensor
    """[B, S] at the opening of the next slot."""
    reward: Tensor
    """[B]"""
    rates: Rates
    power_w: Tensor
    """[B]"""
    action: PhysicalAction
    """What the raw action meant."""
    truncated: bool
    """The episode has reached its time limit (in all worlds at once); it never terminates."""


class Environment:
    """B worlds of one scenario, stepped together; everything random comes from one seeded generator.

    `timing: pre`: the reward of a slot takes the rates of the channels observed at its opening and the power of the
    displacement made in it; the vehicle is at the new place when the next slot opens. It moves as commanded, except
    that it stops at the box, and then pays for what it moved: edge-on flight costs less than hovering, so a vehicle
    that paid for the command could save power by pushing against the wall.

    `acceleration_mps2` gives the vehicle inertia: its velocity changes at most this fast and it makes what it can of a
    displacement, as the bridge's slot profile does in flight. Without, it moves as by teleport, as in the paper.

    The same seed and batch size give the same episodes, bit for bit.
    """

    def __init__(self, scenario: Scenario, batch: int, seed: int, acceleration_mps2: float | None = None) -> None:
        self.scenario = scenario
        self.batch = batch
        self.acceleration_mps2 = acceleration_mps2
        self.generator = torch.Generator().manual_seed(seed)
        self.normalisation = Normalisation.of(scenario)
        self.slot = 0
        self.world: World | None = None
        """None before the first `reset`."""
        low, high = torch.tensor(scenario.box_enu).unbind(-1)
        self._low, self._high = low, high
        self._start = torch.tensor(scenario.start_enu).expand(batch, 3)
        self._yaw = torch.full((batch,), scenario.panel_heading_rad)

    def reset(self) -> Tensor:
        """Begin an episode in every world; returns the observations [B, S]."""
        self.slot = 0
        users = initial_users(self.scenario, (self.batch,), self.generator)
        return self._open(self._start, torch.zeros(self.batch, 3), users)

    def step(self, raw: Tensor) -> Step:
        """Live through a slot with raw actions [B, 3 + 3N + 2MJ].

        Raises RawActionError for actions that are not finite, RuntimeError before `reset` or after the last slot.
        """
        if self.world is None or self.slot >= self.scenario.slots:
            raise RuntimeError("the episode is over or has not begun: reset first")
        world, scenario = self.world, self.scenario
        action = decode(raw, scenario)
        trc = Trc(action.theta_reflection, action.split_angle, action.sign)
        rates = slot_rates(scenario, world.channels, trc, action.beamforming)
        made, velocity = self._move(world.velocity_enu, action.displacement_enu)
        position = torch.clamp(world.position_enu + made, self._low, self._high)
        velocity = torch.where(position == world.position_enu + made, velocity, 0.0)
        power = slot_power(scenario, (position - world.position_enu) / scenario.slot_s, self._yaw)

        self.slot += 1
        observation = self._open(position, velocity, move_users(scenario, world.users, self.generator))
        return Step(
            observation=observation,
            reward=reward(scenario, rates.fair_rate_bps, power),
            rates=rates,
            power_w=power,
            action=action,
            truncated=self.slot == scenario.slots,
        )

    def _move(self, velocity_enu: Tensor, displacement_enu: Tensor) -> tuple[Tensor, Tensor]:
        if self.acceleration_mps2 is None:
            return displacement_enu, velocity_enu
        return reachable(velocity_enu, displacement_enu, self.acceleration_mps2, self.scenario)

    def _open(self, position_enu: Tensor, velocity_enu: Tensor, users: Users) -> Tensor:
        """Open a slot: draw its channels and observe them."""
        channels = draw_channels(self.scenario, position_enu, self._yaw, users.position_enu, self.generator)
        self.world = World(position_enu, velocity_enu, users, channels)
        return observe(position_enu, channels, self.normalisation)
