"""``simulate`` as its users run it."""

import numpy as np
import pytest
from good_input import ROBOT, refused

from sim2real.cli import main
from sim2real.model import JointModel, Model, write_model
from sim2real.recording import read_recording


@pytest.fixture
def files(tmp_path):
    """Robot, model and commands of half a second; a function that runs ``simulate`` on them."""
    (tmp_path / "robot.toml").write_text(ROBOT)
    write_model(Model(joints={"j1": JointModel(2.0, 0.06, 0.04, 0.002)}), tmp_path / "model.json")
    t = 0.02 * np.arange(26)
    rows = [f"{x:.2f},{0.5 * np.sin(9 * x):.4f}" for x in t]
    (tmp_path / "wave.csv").write_text("\n".join(["t_s,j1.command_rad", *rows]) + "\n")

    def run(*more):
        return main(
            ["simulate", str(tmp_path / "model.json"), str(tmp_path / "wave.csv"),
             "--robot", str(tmp_path / "robot.toml"), "--out", str(tmp_path / "swim.csv"),
             "--dimensions", "2", "--cell-m", "0.04", *more]
        )  # fmt: skip

    run.folder = tmp_path
    return run


def test_commands_are_swum_into_a_pool_recording(files):
    assert files() == 0
    swim = read_recording(files.folder / "swim.csv")
    assert swim.kind == "pool"
    assert swim.t.size == 26
    assert swim.is_simulated
    assert np.abs(swim.position[:3]).max() < 1e-6 < 0.05 < np.abs(swim.position).max()
    assert set(swim.columns) == {"body.x_m", "body.y_m", "body.yaw_rad"}
    assert np.ptp(swim.columns["body.yaw_rad"]) > 0.01


def test_what_cannot_swim_is_refused_in_one_line(files, capsys):
    wave, robot = files.folder / "wave.csv", files.folder / "robot.toml"
    whole = wave.read_text()
    wave.write_text(whole.replace("0.10,0", "0.10,nan", 1))
    refused(capsys, files(), "wave.csv", "row")
    wave.write_text(whole.replace("j1.", "j9."))
    refused(capsys, files(), "'j9'", "one of j1")
    wave.write_text(whole)
    robot.write_text(ROBOT.replace("mass_kg = 0.5", "mass_kg = 0", 1))
    refused(capsys, files(), "mass_kg")
    assert not (files.folder / "swim.csv").exists()


def test_a_picture_and_a_video_of_the_swim(files):
    folder = files.folder
    given = ["--plot", str(folder / "end.png"), "--video", str(folder / "swim.mp4")]
    assert files(*given) == 0
    assert (folder / "end.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "swim.mp4").stat().st_size > 1000


def test_pictures_that_cannot_be_written_are_refused_before_anything_is_read(files, capsys):
    folder = files.folder
    (folder / "model.json").unlink()
    refused(capsys, files("--plot", str(folder / "end.jpg")), "a name that ends in .png")
    refused(capsys, files("--video", str(folder / "swim.mov")), "ends in .mp4 or .avi or .gif")
    refused(capsys, files("--video", str(folder / "robot.toml" / "swim.mp4")), "robot.toml")
