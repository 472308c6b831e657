"""What of a commanded displacement a vehicle with inertia makes, for many vehicles at once.

The batched form of `airframe.slot_profile.reach`, which plans the same in flight.
"""

import torch
from torch import Tensor

from rf_model.scenario import Scenario


def reachable(
    velocity_enu: Tensor, displacement_enu: Tensor, acceleration_mps2: float, scenario: Scenario
) -> tuple[Tensor, Tensor]:
    """Displacement [..., 3] m made in a slot and velocity [..., 3] m/s at its end.

    From a velocity within the scenario's speed limits, towards a displacement within them: constant acceleration, then
    constant velocity.
    """
    slot_s = scenario.slot_s
    shortfall = displacement_enu - velocity_enu * slot_s
    distance = shortfall.norm(dim=-1, keepdim=True)
    direction = shortfall / distance.clip(min=1e-9)
    fastest = acceleration_mps2 * slot_s
    change = fastest - (fastest**2 - 2 * acceleration_mps2 * distance).clip(min=0).sqrt()
    change = torch.minimum(change, _speed_room(velocity_enu, direction, scenario))
    made = velocity_enu * slot_s + direction * (change * slot_s - change**2 / (2 * acceleration_mps2))
    return made, velocity_enu + direction * change


def _speed_room(velocity_enu: Tensor, direction: Tensor, scenario: Scenario) -> Tensor:
    """Largest s for which velocity + s * direction keeps the limits of speed, climb and descent [..., 1]."""
    up = scenario.climb_up_mps or scenario.v_max_mps
    down = scenario.climb_down_mps or scenario.v_max_mps
    vx, vy, vz = torch.split(velocity_enu, 1, dim=-1)
    ux, uy, uz = torch.split(direction, 1, dim=-1)
    vertical = torch.where(uz > 0, up - vz, -down - vz) / torch.where(uz == 0, 1.0, uz)
    spare = (scenario.v_max_mps**2 - vx**2 - vy**2).clip(min=0)
    along, across = vx * ux + vy * uy, ux**2 + uy**2
    horizontal = ((along**2 + across * spare).sqrt() - along) / torch.where(across == 0, 1.0, across)
    vertical = torch.where(uz.abs() > 1e-12, vertical.clip(min=0), torch.inf)
    return torch.minimum(vertical, torch.where(across > 1e-12, horizontal, torch.inf))
