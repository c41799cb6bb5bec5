"""What the README and the examples promise, run."""

import io as memory
import re
from contextlib import redirect_stdout
from pathlib import Path

import _clips as clips
import _competitors as competitors
import benchmark_memory
import benchmark_speed
import multiresolution
import plot_motion
import pytest
import reproduce_courty2008 as courty
import reproduce_dean as dean
import reproduce_szczesna2012 as szczesna
import torch
from bvh_files import one_joint
from motions import smooth_motion

from torchquat import bilateral_filter, gaussian_filter, metrics, noise, so3

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
DEMO = ROOT / "examples" / "data" / "sports2d_demo.npz"


def test_the_example_of_the_readme_prints_what_stands_there(tmp_path, monkeypatch):
    blocks = re.findall(r"```python\n(.*?)```\s+```\n(.*?)```", README, re.DOTALL)
    assert len(blocks) == 1
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    said = memory.StringIO()
    with redirect_stdout(said):
        exec(compile(blocks[0][0], "README.md", "exec"), {})
    assert said.getvalue() == blocks[0][1]
    assert (tmp_path / "smooth.bvh").exists()


def test_files_that_the_readme_names_exist():
    for link in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / link).exists(), link
    for path in re.findall(r"(?:examples|configs|tests)/[\w./]+\.(?:py|yaml|npz)", README):
        assert (ROOT / path).exists(), path


def test_plot(tmp_path, capsys):
    out = tmp_path / "plot.png"
    assert plot_motion.main([str(DEMO), str(DEMO), "--output", str(out)]) == 0
    assert out.read_bytes().startswith(b"\x89PNG") and str(out) in capsys.readouterr().out


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--joint", "Tail"], "joints must be of ['Hips', "),
        (["--start", "999"], "start must be in [0, 230), got 999"),
    ],
)
def test_plot_says_what_is_wrong(extra, message, tmp_path, capsys):
    assert (
        plot_motion.main([str(DEMO), str(DEMO), "--output", str(tmp_path / "x.png"), *extra]) == 1
    )
    assert message in capsys.readouterr().err


def test_plot_needs_the_same_joints(tmp_path, capsys):
    (tmp_path / "one.bvh").write_text(one_joint("1 2 3"))
    arguments = [str(DEMO), str(tmp_path / "one.bvh"), "--output", str(tmp_path / "x.png")]
    assert plot_motion.main(arguments) == 1
    assert "same joints and frames" in capsys.readouterr().err


def test_plot_of_one_joint(tmp_path, capsys):
    """Without an end site there is no bone: only its speed is drawn."""
    path, out = tmp_path / "one.bvh", tmp_path / "x.png"
    path.write_text(one_joint("1 2 3", "2 3 4", "3 4 5", "4 5 6", "5 6 7"))
    arguments = [str(path), str(path), "--output", str(out), "--joint", "hip"]
    assert plot_motion.main(arguments) == 0
    assert out.read_bytes().startswith(b"\x89PNG")
    capsys.readouterr()


def figures(lines, label):
    """All numbers of the line with a label."""
    line = next(line for line in lines if line.strip().startswith(label))
    return [float(number) for number in re.findall(r"\d+\.\d+", line[len(label) :])]


def test_the_paper_on_a_synthetic_arm(tmp_path):
    lines = courty.reproduce(clips.synthetic_arm(), "RightHand", tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fig2.png", "fig3.png", "fig4.png"]
    speed, error = lines[: lines.index(next(x for x in lines if x.startswith("Fig. 3")))], lines[6:]
    # Fig. 2: the Gaussian filter lowers the peak speed, the bilateral keeps it or amplifies it
    assert figures(speed, "Gaussian")[0] < 0.7 < figures(speed, "bilateral, sigma_g = 0.316")[0]
    # Fig. 3: a valley over the passes, with sigma_g read as a variance; hardly a change as printed
    start, _, five, fifteen = figures(error, "bilateral, sigma_g = 0.316")
    assert five < 0.3 * start and five < fifteen
    start, _, five, _ = figures(error, "bilateral, sigma_g = 0.1 ")
    assert five > 0.95 * start


def test_a_real_clip(shared_data, tmp_path):
    motion = clips.middle(shared_data / "cmu" / "05_03.bvh", courty.FRAMES, frame_rate=60.0)
    assert len(motion.q) == courty.FRAMES and motion.frame_rate == pytest.approx(60, rel=1e-3)
    assert len(courty.reproduce(motion, "RightHand", tmp_path)) == 19


def row(lines, label):
    """The first line that starts with a label, its numbers."""
    line = next(line for line in lines if line.strip().startswith(label))
    return [float(number) for number in re.findall(r"-?\d+\.\d+", line.strip()[len(label) :])]


def test_dean_on_a_synthetic_run(tmp_path, monkeypatch):
    monkeypatch.setattr(dean, "LIKENESS", (0.008, 0.064, 0.128, 0.256))
    lines = dean.reproduce(clips.synthetic_run(120), tmp_path, draws=1)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fig4.png", "fig5.png", "fig6.png"]
    noisy, tuned = row(lines, "noisy"), row(lines, dean.TUNED)
    # 10 log10(pi^2 / (3 (15 * 0.008)^2)) = 23.6 dB: the size of the noise, worked out by hand
    assert noisy[1] == pytest.approx(23.6, abs=0.2)
    assert all(after > before for before, after in zip(noisy, tuned, strict=True))
    # the published sigma is far too small for more noise than its own
    assert row(lines, dean.PUBLISHED)[1] < tuned[1] - 3.0


def test_szczesna_on_a_synthetic_run(tmp_path):
    lines = szczesna.reproduce(clips.synthetic_run(300), "LeftUpLeg", tmp_path)
    assert len(list(tmp_path.glob("fig*.png"))) == 7
    haar, linear = (row(lines, name) for name in szczesna.SCHEMES)
    assert all(b < a for a, b in zip(haar, linear, strict=True))  # details [deg], Fig. 5 to 8
    errors = lines[lines.index(next(line for line in lines if line.startswith("Fig. 9"))) :]
    noisy, haar, linear = (row(errors, name)[0] for name in ("noisy", "haar", "linear"))
    assert noisy == pytest.approx(0.5 * 3**0.5, rel=0.1)
    assert linear < haar and linear < noisy
    right, printed = (float(line.split()[-1]) for line in lines[-3:-1])
    assert right < 1e-10 < 0.01 < printed
    with pytest.raises(ValueError, match="joint must be one of"):
        szczesna.reproduce(clips.synthetic_run(30), "Tail", tmp_path)


def test_multiresolution_on_the_demo(tmp_path, capsys):
    assert multiresolution.main(["--output", str(tmp_path)]) == 0
    names = {"compression.png", "features.png", "editing.png", "edited.bvh"}
    assert {path.name for path in tmp_path.iterdir()} == names
    lines = capsys.readouterr().out.splitlines()
    held, linear = row(lines, "slerp"), row(lines, "linear")
    assert linear[1] < 0.5 * held[1], "at half the size"  # pairs of ratio and error
    assert multiresolution.main(["--output", str(tmp_path), "--joint", "Tail"]) == 1
    assert multiresolution.main(["--output", str(tmp_path), "--gains", "1", "0"]) == 0


def test_memory_is_measured(capsys, monkeypatch):
    chosen = {name: benchmark_memory.FILTERS[name] for name in ("non-local, pose",)}
    monkeypatch.setattr(benchmark_memory, "FILTERS", chosen)
    assert benchmark_memory.main(["--frames", "20000", "--joints", "24"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert 1.0 < row(lines, "non-local, pose")[0] < 40.0  # a sensible figure, not a target


def test_speed_is_measured(tmp_path, capsys):
    arguments = ["--frames", "64", "96", "--joints", "2", "--slow", "--output", str(tmp_path)]
    assert benchmark_speed.main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    assert row(lines, benchmark_speed.UNIT)[1] == 1.0
    for name in (*benchmark_speed.FILTERS, "SmoothNet-shaped network", "copy of the tensor"):
        assert row(lines, f"{name} ")[0] > 0.0
    assert (tmp_path / "speed_2_joints_batch_1_1_threads.png").exists()


@pytest.mark.parametrize("name", [*competitors.COMPETITORS, *competitors.SLOW])
def test_competitors_smooth_what_they_are_given(name, rng):
    """They are there to be compared with: each must do its work, if in its own way."""
    clean = gaussian_filter(smooth_motion(frames=60, joints=2, step=0.05, rng=rng), sigma_t=3.0)
    noisy = noise.gaussian(clean, 0.05, generator=rng)
    run = (competitors.COMPETITORS | competitors.SLOW)[name]
    smooth = torch.from_numpy(run(noisy.numpy()))
    before, after = (metrics.mean_squared_error(q, clean) for q in (noisy, smooth))
    assert after < 0.6 * before, f"{before:.2e} -> {after:.2e} rad^2"
    if name.startswith("Courty"):
        ours = bilateral_filter(noisy, sigma_t=1.0, sigma_g=0.3, boundary="replicate")
        assert so3.distance(smooth, ours).mean() < 0.01  # log maps instead of summed increments


def test_the_network_takes_every_frame():
    network = competitors.smooth_net(2)
    assert network(torch.rand(70, 2, 4)).shape == (70, 2, 4)
