"""What the README and the examples promise, run."""

import io as memory
import re
from contextlib import redirect_stdout
from pathlib import Path

import _clips as clips
import plot_motion
import pytest
import reproduce_courty2008 as courty
from bvh_files import one_joint

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
