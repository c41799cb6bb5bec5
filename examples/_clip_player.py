"""Both skeletons side by side in a page that plays without a server, by viser."""

import io
import math
import warnings
from contextlib import redirect_stdout

import numpy as np
import torch
from _clip_plots import AFTER, BEFORE, REPAIRED
from torch import Tensor

from torchquat import Skeleton

try:
    import viser
except ImportError:
    raise ValueError("--report needs viser: pip install 'torchquat[view]'") from None

__all__ = ["MOST", "bones", "player"]

MOST = 2000
"""Frames that a page plays; of longer clips every second, third, ... is shown."""
APART = 0.6
"""Half of the way between the skeletons, in heights."""


def player(
    skeleton: Skeleton,
    before: Tensor,
    after: Tensor,
    repaired: Tensor,
    frame_rate: float,
) -> str:
    """A page in which both motions are played, their roots in one place.

    Args:
        skeleton: Of both.
        before: Local rotations ``(T, J, 4)``.
        after: The same, filtered.
        repaired: Whose bones are marked, booleans ``(T, J)``.
        frame_rate: Frames per second.

    Returns:
        HTML that loads nothing.
    """
    step = -(-len(before) // MOST)
    first, second = (bones(skeleton, q[::step]) for q in (before, after))
    drawn = _upright(torch.cat([first, second]))
    first, second = drawn.split(len(first))
    marked = _marked(skeleton, repaired, step)
    with redirect_stdout(io.StringIO()), warnings.catch_warnings():  # it announces its port
        warnings.simplefilter("ignore")
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            return _recorded(server, first, second, marked, frame_rate / step)
        finally:
            server.stop()


def bones(skeleton: Skeleton, q: Tensor) -> Tensor:
    """Both ends of every bone ``(T, bones, 2, 3)``, seen from the root."""
    rotations, positions = skeleton.forward_kinematics(q)
    parents = [parent for parent in skeleton.parents if parent >= 0]
    children = [joint for joint, parent in enumerate(skeleton.parents) if parent >= 0]
    made = torch.stack([positions[:, parents], positions[:, children]], 2)
    if skeleton.end_sites:
        joints = [joint for joint, _ in skeleton.end_sites]
        tips = skeleton.tips(rotations, positions)
        made = torch.cat([made, torch.stack([positions[:, joints], tips], 2)], 1)
    return made - positions[:, :1, None]


def _marked(skeleton: Skeleton, repaired: Tensor, step: int) -> Tensor:
    """The bones that a repaired joint turns, in any of the frames that one stands for."""
    joints = [parent for parent in skeleton.parents if parent >= 0]
    joints += [joint for joint, _ in skeleton.end_sites]
    padded = torch.nn.functional.pad(repaired.T, (0, -len(repaired) % step))
    return padded.unflatten(-1, (-1, step)).any(-1).T[:, joints]


def _upright(drawn: Tensor) -> Tensor:
    """One high, about 0, y up: the axis along which most bodies are long."""
    extent = drawn.flatten(1, 2)
    size = (extent.amax(1) - extent.amin(1)).median(0).values
    if size[2] > 1.2 * size[1]:
        drawn = torch.stack([drawn[..., 0], drawn[..., 2], -drawn[..., 1]], -1)
        size = size[[0, 2, 1]]
    return drawn / max(float(size[1]), 0.5 * float(size.max()), 1e-9)


def _recorded(
    server: viser.ViserServer, first: Tensor, second: Tensor, marked: Tensor, frame_rate: float
) -> str:
    server.scene.set_up_direction("+y")
    # from afar: seen from nearby, one would be turned to the left and the other to the right
    server.initial_camera.position = (0.0, 0.6, 15.0)
    server.initial_camera.look_at = (0.0, 0.0, 0.0)
    server.initial_camera.fov = math.radians(6.0)
    sides = []
    for name, drawn, side in (("before", first, -APART), ("after", second, APART)):
        points = (drawn + drawn.new_tensor([side, 0.0, 0.0])).float().numpy()
        server.scene.add_label(f"/{name}/label", name, position=(side, 0.62, 0.0))
        sides.append((name, points))
    colors = {"before": _colors(marked, BEFORE), "after": _colors(marked, AFTER)}
    handles = [
        server.scene.add_line_segments(
            f"/{name}/bones", points[0], colors[name][0], thickness=0.018
        )
        for name, points in sides
    ]
    recording = server.get_scene_serializer()
    for frame in range(1, len(first)):
        recording.insert_sleep(1.0 / frame_rate)
        for handle, (name, points) in zip(handles, sides, strict=True):
            handle.points = points[frame]
            if not np.array_equal(colors[name][frame], colors[name][frame - 1]):
                handle.colors = colors[name][frame]
    recording.insert_sleep(1.0 / frame_rate)
    return recording.as_html()


def _colors(marked: Tensor, plain: str) -> np.ndarray:
    """Of both ends of every bone, ``(T, bones, 2, 3)``."""
    color = torch.where(marked[..., None], _rgb(REPAIRED), _rgb(plain))
    return color[:, :, None].expand(-1, -1, 2, -1).contiguous().numpy()


def _rgb(color: str) -> Tensor:
    """The bytes that show a colour: those of single bones are taken for linear light."""
    shown = torch.tensor(list(bytes.fromhex(color[1:]))) / 255.0
    return (255.0 * shown**2.2).round().to(torch.uint8)
