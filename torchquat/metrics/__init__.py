"""What a filter gained and what it lost.

Quaternions here are complete: fill missing frames first (:func:`torchquat.fill_missing`). Means run
over everything given. A sequence too short for a difference counts as standing still.
"""

from torchquat.metrics.error import geodesic_rmse_deg, mean_squared_error, psnr
from torchquat.metrics.motion import (
    angular_acceleration,
    angular_velocity,
    jitter,
    lag,
    peak_speed_kept,
    range_of_motion_kept,
)
from torchquat.metrics.place import acceleration_error, foot_slide, mpjpe

__all__ = [
    "acceleration_error",
    "angular_acceleration",
    "angular_velocity",
    "foot_slide",
    "geodesic_rmse_deg",
    "jitter",
    "lag",
    "mean_squared_error",
    "mpjpe",
    "peak_speed_kept",
    "psnr",
    "range_of_motion_kept",
]
