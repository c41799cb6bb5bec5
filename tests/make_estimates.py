"""Small files as pose estimators write them, with made-up motion.

Keys, shapes and dtypes are those of the producers' own code: GVHMR ``tools/demo/demo.py`` and
``DemoPL.predict``; WHAM ``demo.py``; PHALP ``PHALP.track`` and ``get_human_features``, which
4D-Humans runs; AMASS and SMPL npz. Run as a script it writes one of each into a folder.
"""

import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

FRAMES = 12


def wobble(frames: int, joints: int, seed: int) -> np.ndarray:
    """Smooth rotation vectors ``(frames, joints, 3)``, the root near a half turn, with jitter."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 1, frames)[:, None, None]
    phase, size = rng.uniform(0, 6, (1, joints, 3)), rng.uniform(0.1, 0.5, (1, joints, 3))
    v = size * np.sin(4 * time + phase) + rng.normal(0, 0.02, (frames, joints, 3))
    v[:, 0] = rng.normal([3.13, 0.2, 0.1], 0.05, (frames, 3))
    return Rotation.from_rotvec(v.reshape(-1, 3)).as_rotvec().reshape(v.shape)


def walk(frames: int, seed: int) -> np.ndarray:
    """Positions ``(frames, 3)``."""
    return np.random.default_rng(seed).normal(0, 0.05, (frames, 3)).cumsum(0)


def gvhmr(frames: int = FRAMES) -> dict[str, Any]:
    """What GVHMR saves with ``torch.save``: one storage for the body in both frames."""
    body = torch.from_numpy(wobble(frames, 22, 1)[:, 1:].reshape(1, frames, 63)).float()
    betas = torch.full((1, frames, 10), 0.1)

    def params(seed: int) -> dict[str, torch.Tensor]:
        root = torch.from_numpy(wobble(frames, 1, seed)[:, 0]).float()[None]
        transl = torch.from_numpy(walk(frames, seed)).float()[None]
        return {"body_pose": body, "betas": betas, "global_orient": root, "transl": transl}

    outputs = {
        "model_output": {
            "pred_x": torch.zeros(1, frames, 151),
            "pred_cam": torch.ones(1, frames, 3),
        },
        "decode_dict": {"body_pose": body, "betas": betas},
        "pred_smpl_params_incam": params(3),
        "pred_smpl_params_global": params(2),
        "static_conf_logits": torch.zeros(1, frames, 6),
    }
    return {
        "smpl_params_global": {k: v[0] for k, v in outputs["pred_smpl_params_global"].items()},
        "smpl_params_incam": {k: v[0] for k, v in outputs["pred_smpl_params_incam"].items()},
        "K_fullimg": torch.eye(3).repeat(frames, 1, 1),
        "net_outputs": outputs,
    }


def wham(people: dict[int, list[int]] | None = None) -> dict[int, dict[str, np.ndarray]]:
    """What WHAM saves with joblib: people by number; ``verts`` are cut down to four of 6890."""
    results: dict[int, dict[str, np.ndarray]] = defaultdict(dict)
    for person, numbers in (people or {0: [3, 4, 5, 9, 10, 11], 4: list(range(8))}).items():
        n = len(numbers)
        pose = wobble(n, 24, person).reshape(n, 72).astype(np.float32)
        root = wobble(n, 1, person + 50)[:, 0].astype(np.float32)
        results[person]["pose"] = pose
        results[person]["trans"] = walk(n, person).astype(np.float32)
        results[person]["pose_world"] = np.concatenate([root, pose[:, 3:]], -1)
        results[person]["trans_world"] = walk(n, person + 1).astype(np.float32)
        results[person]["betas"] = np.zeros((n, 10), np.float32)
        results[person]["verts"] = np.ones((n, 4, 3), np.float32)
        results[person]["frame_ids"] = np.array(numbers)
    return results


def phalp(frames: int = FRAMES) -> dict[str, dict[str, Any]]:
    """What PHALP saves with joblib. Person 1 is lost in frames 4 and 5, person 2 comes later.

    A person that is only predicted keeps the entry of the frame where it was last seen: the same
    dictionary and arrays once more.
    """
    seen = {1: [t for t in range(frames) if t not in (4, 5)], 2: list(range(3, frames - 2))}
    poses = {person: wobble(frames, 24, person + 70) for person in seen}
    cameras = {person: walk(frames, person + 70) + np.array([0, 0, 30]) for person in seen}
    history: dict[int, dict[str, Any]] = {}
    lists = ("tracked_ids", "tracked_bbox", "tid", "bbox", "tracked_time", "conf", "smpl", "camera")
    results: dict[str, dict[str, Any]] = {}
    for t in range(frames):
        name = f"outputs/_DEMO/clip/img/{t + 1:06d}.jpg"
        frame: dict[str, Any] = {"time": t, "shot": 0, "frame_path": name}
        frame |= {key: [] for key in lists}
        for person, own in seen.items():
            if t in own:
                matrices = Rotation.from_rotvec(poses[person][t]).as_matrix().astype(np.float32)
                history[person] = {
                    "bbox": np.array([10.0, 20.0, 100.0, 200.0]),
                    "conf": 0.9,
                    "smpl": {
                        "global_orient": matrices[:1],
                        "body_pose": matrices[1:],
                        "betas": np.zeros(10, np.float32),
                    },
                    "camera": cameras[person][t].astype(np.float32),
                    "last": t,
                }
                frame["tracked_ids"].append(person)
                frame["tracked_bbox"].append(history[person]["bbox"])
            if person in history and t <= own[-1]:
                frame["tid"].append(person)
                frame["tracked_time"].append(t - history[person]["last"])
                for key in ("bbox", "conf", "smpl", "camera"):
                    frame[key].append(history[person][key])
        results[name] = frame
    return results


def amass(frames: int = FRAMES) -> dict[str, np.ndarray]:
    """SMPL-X as AMASS keeps it: ``poses``, and parts of it once more."""
    poses = wobble(frames, 55, 9).reshape(frames, 165)
    return {
        "gender": np.array("neutral"),
        "surface_model_type": np.array("smplx"),
        "mocap_frame_rate": np.array(30.0),
        "trans": walk(frames, 9),
        "poses": poses,
        "betas": np.zeros(16),
        "root_orient": poses[:, :3],
        "pose_body": poses[:, 3:66],
        "pose_hand": poses[:, 75:],
        "pose_jaw": poses[:, 66:69],
        "pose_eye": poses[:, 69:75],
    }


def smpl(frames: int = FRAMES) -> dict[str, np.ndarray]:
    """SMPL parameters with one key a part, as fitting scripts save them."""
    v = wobble(frames, 24, 5).astype(np.float32)
    return {
        "global_orient": v[:, 0],
        "body_pose": v[:, 1:].reshape(frames, 69),
        "betas": np.zeros(10, np.float32),
        "transl": walk(frames, 5).astype(np.float32),
        "fps": np.array(25),
    }


def main(folder: Path) -> None:
    """Write one file of each producer."""
    import joblib

    torch.save(gvhmr(), folder / "hmr4d_results.pt")
    joblib.dump(wham(), folder / "wham_output.pkl")
    joblib.dump(phalp(), folder / "demo_clip.pkl", compress=3)
    np.savez(folder / "amass.npz", **amass())
    np.savez(folder / "smpl.npz", **smpl())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
