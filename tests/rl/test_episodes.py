"""Swims: their figures, and a film with the robot, its way and its target on it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from rl.experiments.episodes import energy, path_length, run_episodes
from rl.experiments.film import TARGET, Film
from rl.experiments.named import controller_of
from rl.task import TASKS
from sim.view.video import FRAMES_PER_S, Video


def test_energy_is_the_sum_of_squares_of_what_is_known() -> None:
    rate = np.full((101, 3, 3), 2.0)
    rate[51:, 1], rate[:, 2] = np.nan, np.nan
    assert energy(rate)[:2].tolist() == [101 * 12.0, 51 * 12.0]
    assert np.isnan(energy(rate)[2])


def test_path_of_a_straight_line() -> None:
    line = np.linspace(0, 1, 51)[:, None, None] * np.array([[3.0, 4.0], [0.0, 0.0]])
    line[41:, 0] = np.nan
    assert path_length(line) == pytest.approx([4.0, 0.0])


def test_a_film_shows_the_whole_swim_and_the_target(world_of, tmp_path):
    path = tmp_path / "swim.avi"
    world = world_of(2, replace(TASKS["near"], steps=100), seed=1)
    with Video(path) as video, Film(video, world, "pnl", width=320) as film:
        run_episodes(world, controller_of("pnl", world.simulator.robot), watch=film)
    read = cv2.VideoCapture(str(path))
    frames = []
    while (more := read.read())[0]:
        frames.append(more[1][:, :, ::-1])
    assert abs(len(frames) - (2.0 + 1.0) * FRAMES_PER_S) <= 2
    green = np.abs(frames[0].astype(int) - np.array(TARGET)).max(axis=2) < 60
    assert 5 < green.sum() < 0.02 * green.size
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 100
