"""Where users are and how they walk."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from rf_model.geometry import constant
from rf_model.scenario import Scenario

HEADING_NOISE_RAD = {"random": 0.5, "directional": 0.05}
"""Standard deviation of the heading's change in a slot."""


@dataclass(frozen=True)
class Users:
    """Users on foot, with leading batch dimensions `...`."""

    position_enu: Tensor
    """[..., J, 3] m"""
    heading_rad: Tensor
    """[..., J], 0 = east, counter-clockwise."""


def initial_users(
    scenario: Scenario, batch_shape: tuple[int, ...], generator: torch.Generator, dtype: torch.dtype = torch.float32
) -> Users:
    """Users spread evenly over the area of their sectors, on the generator's device.

    The first P are in the sector on the base station's side of the panel, the others in the opposite one. Headings are
    even over the circle; with `mobility: directional` all users of a world share one.
    """
    shape = (*batch_shape, scenario.users)

    def uniform(size: tuple[int, ...]) -> Tensor:
        return torch.rand(size, generator=generator, dtype=dtype, device=generator.device)

    inner, outer = scenario.user_radius_m
    radius = (inner**2 + uniform(shape) * (outer**2 - inner**2)).sqrt()
    axis = scenario.panel_heading_rad + math.pi * (constant(_sides(scenario), dtype, generator.device) < 0)
    angle = axis + (2 * uniform(shape) - 1) * scenario.user_half_angle_rad
    centre_x, centre_y = scenario.user_centre_enu
    position = torch.stack(
        (
            centre_x + radius * torch.cos(angle),
            centre_y + radius * torch.sin(angle),
            torch.full_like(radius, scenario.user_height_m),
        ),
        dim=-1,
    )
    headings = (*batch_shape, 1) if scenario.mobility == "directional" else shape
    heading = (2 * math.pi * uniform(headings) - math.pi).expand(shape)
    return Users(position_enu=position, heading_rad=heading)


def move_users(scenario: Scenario, users: Users, generator: torch.Generator) -> Users:
    """Users one slot later, their headings' noise drawn from the generator: see `walked_users`."""
    heading = users.heading_rad
    noise = torch.randn(heading.shape, generator=generator, dtype=heading.dtype, device=heading.device)
    return walked_users(scenario, users, noise)


def walked_users(scenario: Scenario, users: Users, noise: Tensor) -> Users:
    """Users one slot later: a step at the scenario's speed along a heading that drifts by N(0, 1) `noise` [..., J].

    With `user_bounds: sector`, a user whose step would leave its sector does not step, and turns round.
    """
    heading = torch.add(users.heading_rad, noise, alpha=HEADING_NOISE_RAD[scenario.mobility])
    step = scenario.user_speed_mps * scenario.slot_s
    x, y, z = users.position_enu.unbind(-1)
    x, y = torch.add(x, torch.cos(heading), alpha=step), torch.add(y, torch.sin(heading), alpha=step)
    moved = torch.stack((x, y, z), dim=-1)
    if scenario.user_bounds == "none":
        return Users(position_enu=moved, heading_rad=heading)
    inside = in_sector(scenario, moved)
    return Users(
        position_enu=torch.where(inside.unsqueeze(-1), moved, users.position_enu),
        heading_rad=torch.where(inside, heading, heading + math.pi),
    )


def in_sector(scenario: Scenario, position_enu: Tensor) -> Tensor:
    """Which users [..., J] are within the sector that they started in."""
    dtype, device = position_enu.dtype, position_enu.device
    heading, sides = scenario.panel_heading_rad, _sides(scenario)
    axes = tuple(side * part for side in sides for part in (math.cos(heading), math.sin(heading)))
    plane = position_enu[..., :2] - constant(scenario.user_centre_enu, dtype, device)
    radius = torch.linalg.vector_norm(plane, dim=-1)
    along = (plane * constant(axes, dtype, device).view(-1, 2)).sum(-1)
    within_angle = torch.sub(along, radius, alpha=math.cos(scenario.user_half_angle_rad)) >= -1e-9
    within_ring: Tensor = radius.clamp(*scenario.user_radius_m) == radius
    return within_ring & within_angle


def _sides(scenario: Scenario) -> tuple[float, ...]:
    """Whether each user's sector lies along the panel's normal (+1) or against it (-1): J numbers.

    The first P are on the base station's side of the panel, as it is at the start.
    """
    heading = scenario.panel_heading_rad
    east = scenario.base_station_enu[0] - scenario.start_enu[0]
    north = scenario.base_station_enu[1] - scenario.start_enu[1]
    facing = 1.0 if east * math.cos(heading) + north * math.sin(heading) >= 0 else -1.0
    first = scenario.reflection_count
    return (facing,) * first + (-facing,) * (scenario.users - first)
