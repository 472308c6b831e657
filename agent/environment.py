"""The loop closed without an autopilot: many worlds side by side as tensors, for training."""

from dataclasses import dataclass

import torch
from torch import Tensor

from agent.decoding import PhysicalAction, decode
from agent.inertia import reachable
from agent.observation import Normalisation, channel_size, observe
from rf_model.channels import Channels, Fading, draw_fading, faded_channels
from rf_model.csi import Observed
from rf_model.geometry import panel_frame
from rf_model.mobility import Users, initial_users, walked_users
from rf_model.reward import reward
from rf_model.scenario import Scenario
from rf_model.world import Rates, slot_power, slot_rates, steady_tilt

BLOCK = 2**16
"""Complex numbers of fading drawn at once: single worlds draw a whole episode's, large batches a slot's."""


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

    `timing: pre`: the reward of a slot takes the rates of the channels at its opening and the power of the displacement
    made in it; the vehicle is at the new place when the next slot opens. (`post`: it takes the rates of the channels
    there.) It moves as commanded, except that it stops at the box, and then pays for what it moved: edge-on flight
    costs less than hovering, so a vehicle that paid for the command could save power by pushing against the wall.

    `acceleration_mps2` gives the vehicle inertia: its velocity changes at most this fast and it makes what it can of a
    displacement, as the bridge's slot profile does in flight; it pays for the velocities on the way. Without, it moves
    as by teleport, as in the paper.

    With `attitude: flown` it leans as it would at the mean velocity of the slot before. What is observed of the
    channels follows from `csi_error_variance` and `csi_delay_slots`; rates are those of the channels themselves.

    The same seed, batch size and device give the same episodes, bit for bit.
    """

    def __init__(
        self,
        scenario: Scenario,
        batch: int,
        seed: int,
        acceleration_mps2: float | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        self.scenario = scenario
        self.batch = batch
        self.acceleration_mps2 = acceleration_mps2
        self.device = torch.device(device)
        self.generator = torch.Generator(self.device).manual_seed(seed)
        self.normalisation = Normalisation.of(scenario, self.device)
        self.slot = 0
        self.world: World | None = None
        """None before the first `reset`."""
        low, high = torch.tensor(scenario.box_enu, device=self.device).unbind(-1)
        self._low, self._high = low, high
        self._start = torch.tensor(scenario.start_enu, device=self.device).expand(batch, 3)
        self._yaw = torch.full((batch,), scenario.panel_heading_rad, device=self.device)
        self._level = panel_frame(self._yaw)
        self._observed = Observed(scenario)
        self._block = max(1, min(scenario.slots + 1, BLOCK // (batch * channel_size(scenario))))

    def reset(self) -> Tensor:
        """Begin an episode in every world; returns the observations [B, S]."""
        self.slot = 0
        self._observed.forget()
        users = initial_users(self.scenario, (self.batch,), self.generator)
        self._draw()
        still = torch.zeros_like(self._start)
        return self._open(self._start, still, users, still)

    def step(self, raw: Tensor) -> Step:
        """Live through a slot with raw actions [B, 3 + 3N + 2MJ].

        Raises RawActionError for actions that are not finite, RuntimeError before `reset` or after the last slot.
        """
        if self.world is None or self.slot >= self.scenario.slots:
            raise RuntimeError("the episode is over or has not begun: reset first")
        world, scenario = self.world, self.scenario
        action = decode(raw, scenario)
        position, velocity, flown, power = self._moved(world, action.displacement_enu)

        self.slot += 1
        if self.slot % self._block == 0:
            self._draw()
        users = walked_users(scenario, world.users, self._walk[self.slot % self._block])
        observation = self._open(position, velocity, users, flown)
        channels = world.channels if scenario.timing == "pre" else self.world.channels
        rates = slot_rates(scenario, channels, action.trc, action.beamforming)
        return Step(
            observation=observation,
            reward=reward(scenario, rates.fair_rate_bps, power),
            rates=rates,
            power_w=power,
            action=action,
            truncated=self.slot == scenario.slots,
        )

    def _moved(self, world: World, displacement_enu: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Position and velocity [B, 3] at the slot's end, velocity [B, 3] on average, and mean power [B]."""
        made, before = displacement_enu, world.velocity_enu
        if self.acceleration_mps2 is not None:
            made, after = reachable(before, displacement_enu, self.acceleration_mps2, self.scenario)
        free = world.position_enu + made
        position = torch.clamp(free, self._low, self._high)
        flown = (position - world.position_enu) / self.scenario.slot_s
        if self.acceleration_mps2 is None:
            return position, before, flown, slot_power(self.scenario, flown, self._yaw)
        stopped = position != free
        power = self._ramped_power(self.acceleration_mps2, before, after, flown, stopped)
        return position, torch.where(stopped, 0.0, after), flown, power

    def _draw(self) -> None:
        """Draw the fading and the users' headings for a block of slots, because many small draws cost most."""
        scenario, shape = self.scenario, (self._block, self.batch)
        self._fading: Fading = draw_fading(scenario, shape, self.generator, torch.float32)
        self._walk = torch.randn((*shape, scenario.users), generator=self.generator, device=self.device)

    def _ramped_power(
        self, acceleration_mps2: float, before_enu: Tensor, after_enu: Tensor, flown_enu: Tensor, stopped: Tensor
    ) -> Tensor:
        """Mean power of a slot [B] from the velocities [B, 3] at its ends and on average.

        Over the ramp from one velocity to the other (Simpson's rule) and the rest of the slot.
        """
        change = after_enu - before_enu
        on_the_ramp = [before_enu + fraction * change for fraction in (0.0, 0.25, 0.5, 0.75, 1.0)]
        *ramp_power, mean_power = slot_power(self.scenario, torch.stack([*on_the_ramp, flown_enu]), self._yaw)
        ramp = change.norm(dim=-1) / (acceleration_mps2 * self.scenario.slot_s)
        a, b, c, d, e = ramp_power
        power = ramp * (a + 4 * b + 2 * c + 4 * d + e) / 12 + (1 - ramp) * e
        return torch.where(stopped.any(-1), mean_power, power)

    def _open(self, position_enu: Tensor, velocity_enu: Tensor, users: Users, flown_enu: Tensor) -> Tensor:
        """Open a slot: fade its channels and observe them."""
        frame = self._level
        if self.scenario.attitude == "flown":
            frame = panel_frame(self._yaw, *steady_tilt(self.scenario, flown_enu, self._yaw))
        fading = self._fading.slot(self.slot % self._block)
        channels = faded_channels(self.scenario, position_enu, frame, users.position_enu, fading)
        self.world = World(position_enu, velocity_enu, users, channels)
        observed = self._observed.of(channels, self.generator)
        return observe(position_enu, users.position_enu, self.slot, observed, self.normalisation)
