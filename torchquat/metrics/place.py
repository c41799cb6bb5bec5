"""What errors of rotations do to the places of joints, through forward kinematics."""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchquat._checks import check_layout, check_positive
from torchquat.metrics.error import check_pair, single
from torchquat.skeleton import Skeleton

__all__ = ["acceleration_error", "foot_slide", "mpjpe"]


def mpjpe(q: Tensor, reference: Tensor, skeleton: Skeleton) -> Tensor:
    """Mean per joint position error, with both roots in the same place.

    Args:
        q: Local rotations ``(..., T, J, 4)``, each in its parent's frame.
        reference: Local rotations of the same shape.
        skeleton: Of J joints.

    Returns:
        One value [unit of the offsets]. The root, which is always in its place, counts as a joint.

    Raises:
        TypeError: If an input is not a floating-point tensor.
        ValueError: If the shapes differ, or are not those of the skeleton.

    Reference:
        Ionescu et al., "Human3.6M", IEEE TPAMI 2014, eq. 8.
    """
    return _mean(_offset(q, reference, skeleton).norm(dim=-1))


def acceleration_error(
    q: Tensor, reference: Tensor, skeleton: Skeleton, *, frame_rate: float = 1.0
) -> Tensor:
    """Mean norm of the difference of the accelerations of joints.

    Args:
        q: Local rotations ``(..., T, J, 4)``, each in its parent's frame.
        reference: Local rotations of the same shape.
        skeleton: Of J joints.
        frame_rate: Frames per second; 1 gives units per frame^2.

    Returns:
        One value [unit of the offsets / s^2]; 0 for fewer than three frames.

    Raises:
        TypeError: If an input is not a floating-point tensor.
        ValueError: If the shapes differ, or are not those of the skeleton.

    Reference:
        Kanazawa et al., "Learning 3D Human Dynamics from Video", CVPR 2019, section 4.
    """
    # the second difference of the error is the error of the second differences
    bend = _offset(q, reference, skeleton).diff(n=2, dim=-3) * frame_rate**2
    return _mean(bend.norm(dim=-1))


def foot_slide(
    q: Tensor,
    skeleton: Skeleton,
    root_position: Tensor,
    *,
    feet: Sequence[str],
    height: float,
    ground: float | None = None,
    up: int = 1,
    frame_rate: float = 1.0,
) -> Tensor:
    r"""Mean speed along the ground of feet that are near it.

    .. math:: s = v\, (2 - 2^{h / H}) \quad \text{where} \quad h < H

    with the horizontal speed v of a step from one frame to the next and the mean height h above the
    ground during it; lower than the ground counts as on it. Mean over all such steps.

    Args:
        q: Local rotations ``(..., T, J, 4)``, each in its parent's frame.
        skeleton: Of J joints.
        root_position: Where the root is, ``(..., T, 3)`` [unit of the offsets].
        feet: Names of the joints that touch the ground.
        height: Height H below which a foot should stand still, > 0 [unit of the offsets].
        ground: Where the ground is along ``up``; ``None``: where the lowest foot is. Give it to
            compare motions: noise lowers the lowest foot.
        up: Axis that points away from the ground: 0, 1 or 2.
        frame_rate: Frames per second; 1 gives units per frame.

    Returns:
        One value [unit of the offsets / s]; 0 where no foot is near the ground.

    Raises:
        TypeError: If an input is not a floating-point tensor.
        ValueError: If a shape is not that of the skeleton, a name unknown or a value out of range.

    Reference:
        Zhang et al., "Mode-Adaptive Neural Networks for Quadruped Motion Control", ACM TOG 2018,
        with a mean over steps near the ground only.
    """
    check_positive("height", height)
    if up not in (0, 1, 2):
        raise ValueError(f"up must be 0, 1 or 2, got {up!r}.")
    check_layout(q)
    _, position = skeleton.forward_kinematics(single(q), root_position)
    foot = position[..., skeleton.index(feet), :]
    if foot.numel() == 0:
        return foot.new_zeros(())
    along = [axis for axis in range(3) if axis != up]
    speed = foot[..., along].diff(dim=-3).norm(dim=-1) * frame_rate
    level = foot[..., up] - (foot[..., up].min() if ground is None else ground)
    level = 0.5 * (level[..., 1:, :] + level[..., :-1, :]).clamp(min=0)
    near = level < height
    slide = speed * (2.0 - 2.0 ** (level / height).clamp(max=1.0))
    return torch.where(near, slide, 0.0).sum() / near.sum().clamp(min=1)


def _offset(q: Tensor, reference: Tensor, skeleton: Skeleton) -> Tensor:
    """From where the joints should be to where they are, ``(..., T, J, 3)``."""
    q, reference = check_pair(q, reference)
    _, position = skeleton.forward_kinematics(q)
    _, true = skeleton.forward_kinematics(reference)
    return position - true


def _mean(x: Tensor) -> Tensor:
    return x.sum() / max(x.numel(), 1)
