"""Where things lie as seen from the vehicle, in ENU metres with leading batch dimensions `...`."""

import torch
from torch import Tensor

CLOSEST_M = 1.0
"""Distances are taken as at least this: the path-loss models mean nothing nearer, and coincident points stay finite."""


def offset_and_distance(start_enu: Tensor, end_enu: Tensor) -> tuple[Tensor, Tensor]:
    """Vector from start to end [..., 3] and its length [...], at least `CLOSEST_M`."""
    offset = end_enu - start_enu
    return offset, (offset * offset).sum(-1).clamp_min(CLOSEST_M**2).sqrt()


def horizontal_distance(start_enu: Tensor, end_enu: Tensor) -> Tensor:
    """Distance in the plane [...], at least `CLOSEST_M`."""
    plane = (end_enu - start_enu)[..., :2]
    return (plane * plane).sum(-1).clamp_min(CLOSEST_M**2).sqrt()


def panel_cosines(offset_enu: Tensor, distance: Tensor, yaw_rad: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Direction cosines [...] of a direction in the panel's frame: along its normal, its columns and its rows.

    The panel stands upright with normal (cos yaw, sin yaw, 0); columns advance along (-sin yaw, cos yaw, 0), rows
    upwards. `offset_enu` [..., 3] and `distance` [...] come from `offset_and_distance`; `yaw_rad` broadcasts with them.
    """
    x, y, z = (offset_enu / distance.unsqueeze(-1)).unbind(-1)
    cosine, sine = torch.cos(yaw_rad), torch.sin(yaw_rad)
    return x * cosine + y * sine, y * cosine - x * sine, z


def beyond_panel(user_normal: Tensor, base_station_normal: Tensor) -> Tensor:
    """Which users [..., J] lie across the panel's plane from the base station, and so are served by transmission.

    Takes direction cosines along the panel's normal, [..., J] and [...]. On the plane itself: reflection.
    """
    return user_normal * base_station_normal.unsqueeze(-1) < 0
