"""The loop closed without an autopilot: many worlds side by side as tensors, for training."""

from dataclasses import dataclass

import torch
from torch import Tensor

from agent.decoding import PhysicalAction, decode
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
    that paid for the command could save power by pushing against the wall. What autopilot and envelope make of a
    displacement is seen in flight only.

    The same seed and batch size give the same episodes, bit for bit.
    """

    def __init__(self, scenario: Scenario, batch: int, seed: int) -> None:
        self.scenario = scenario
        self.batch = batch
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
        return self._open(self._start, users)

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
        position = torch.clamp(world.position_enu + action.displacement_enu, self._low, self._high)
        power = slot_power(scenario, (position - world.position_enu) / scenario.slot_s, self._yaw)

        self.slot += 1
        observation = self._open(position, move_users(scenario, world.users, self.generator))
        return Step(
            observation=observation,
            reward=reward(scenario, rates.fair_rate_bps, power),
            rates=rates,
            power_w=power,
            action=action,
            truncated=self.slot == scenario.slots,
        )

    def _open(self, position_enu: Tensor, users: Users) -> Tensor:
        """Open a slot: draw its channels and observe them."""
        channels = draw_channels(self.scenario, position_enu, self._yaw, users.position_enu, self.generator)
        self.world = World(position_enu, users, channels)
        return observe(position_enu, channels, self.normalisation)
