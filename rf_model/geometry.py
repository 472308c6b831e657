"""Where things lie as seen from the vehicle, in ENU metres with leading batch dimensions `...`."""

from functools import lru_cache

import torch
from torch import Tensor

CLOSEST_M = 1.0
"""Distances are taken as at least this: the path-loss models mean nothing nearer, and coincident points stay finite."""


@lru_cache(maxsize=64)
def constant(values: tuple[float, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """A vector that does not change, kept because every slot asks for the same few."""
    with torch.inference_mode(False):  # what is kept may be needed for gradients later
        return torch.tensor(values, dtype=dtype, device=device)


def offset_and_distance(start_enu: Tensor, end_enu: Tensor) -> tuple[Tensor, Tensor]:
    """Vector from start to end [..., 3] and its length [...], at least `CLOSEST_M`."""
    offset = end_enu - start_enu
    return offset, torch.linalg.vector_norm(offset, dim=-1).clamp_min(CLOSEST_M)


def horizontal_distance(start_enu: Tensor, end_enu: Tensor) -> Tensor:
    """Distance in the plane [...], at least `CLOSEST_M`."""
    plane = (end_enu - start_enu)[..., :2]
    return (plane * plane).sum(-1).clamp_min(CLOSEST_M**2).sqrt()


def panel_frame(yaw_rad: Tensor, roll_rad: Tensor | None = None, pitch_rad: Tensor | None = None) -> Tensor:
    """The panel's axes in ENU [..., 3, 3]: rows are its normal, the way its columns and the way its rows advance.

    Upright, they are (cos yaw, sin yaw, 0), (-sin yaw, cos yaw, 0) and up. Roll and pitch, of yaw's shape, turn them as
    the body that carries the panel on its x axis: as MAVLink's ATTITUDE, positive to the right and nose up.
    """
    cos_yaw, sin_yaw = torch.cos(yaw_rad), torch.sin(yaw_rad)
    zero = torch.zeros_like(cos_yaw)
    if roll_rad is None or pitch_rad is None:
        flat = (cos_yaw, sin_yaw, zero, -sin_yaw, cos_yaw, zero, zero, zero, torch.ones_like(zero))
        return torch.unflatten(torch.stack(flat, dim=-1), -1, (3, 3))
    cos_roll, sin_roll = torch.cos(roll_rad), torch.sin(roll_rad)
    cos_pitch, sin_pitch = torch.cos(pitch_rad), torch.sin(pitch_rad)
    tilted = (
        cos_pitch * cos_yaw,
        cos_pitch * sin_yaw,
        sin_pitch,
        -sin_pitch * sin_roll * cos_yaw - cos_roll * sin_yaw,
        -sin_pitch * sin_roll * sin_yaw + cos_roll * cos_yaw,
        cos_pitch * sin_roll,
        -sin_pitch * cos_roll * cos_yaw + sin_roll * sin_yaw,
        -sin_pitch * cos_roll * sin_yaw - sin_roll * cos_yaw,
        cos_pitch * cos_roll,
    )
    return torch.unflatten(torch.stack(tilted, dim=-1), -1, (3, 3))


def beyond_panel(user_normal: Tensor, base_station_normal: Tensor) -> Tensor:
    """Which users [..., J] lie across the panel's plane from the base station, and so are served by transmission.

    Takes direction cosines along the panel's normal, [..., J] and [...]. On the plane itself: reflection.
    """
    return user_normal * base_station_normal.unsqueeze(-1) < 0
