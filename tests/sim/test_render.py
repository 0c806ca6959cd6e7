"""Pictures and videos of a swim."""

import numpy as np
import pytest
from swimming_robots import FISH, servos

from sim.plane import depth, plane_of
from sim.render import picture, save_picture
from sim.swimmer import Swimmer
from sim.video import Video
from sim2real.errors import InputError

BOX = (0.9, 0.7, 0.4)


def fish(**more):
    return Swimmer(FISH, servos(), dimensions=2, cell_m=0.04, box_m=BOX, **more)


def test_the_outline_is_where_the_links_are():
    swimmer = fish()
    swimmer.reset(pose=np.array([0.1, 0.05, 0.6]))
    seen = plane_of(swimmer)
    x, y, _ = swimmer.state().pose[0]
    ahead = np.array([np.cos(0.6), np.sin(0.6)])
    places = np.array([x, y]) + np.outer([0.0, 0.5, -0.5], ahead)
    assert (depth(swimmer.hull, seen.links, places[:, 0], places[:, 1]) < 0).tolist() == [
        True, False, False,
    ]  # fmt: skip


def test_water_at_rest_is_white_and_a_vortex_has_its_sign():
    swimmer = fish()
    assert np.abs(plane_of(swimmer).vorticity).max() < 1e-6
    for _ in range(10):
        swimmer.step(np.array([0.6, 0.0, 0.0]))
    spin = plane_of(swimmer).vorticity
    assert spin.max() > 0.5
    assert spin.min() < -0.5


def test_a_picture_shows_the_robot_and_is_a_png(tmp_path):
    image = picture(fish(), width=320)
    assert image.shape[1] == 320
    assert image.shape[0] % 2 == 0
    middle = image[image.shape[0] // 2, 160]
    assert middle.tolist() == [250, 247, 240]
    written = save_picture(image, tmp_path / "fish.png")
    assert written.read_bytes().startswith(b"\x89PNG")


def test_a_video_appears_whole_or_not_at_all(tmp_path):
    av = pytest.importorskip("av")
    swimmer, path = fish(), tmp_path / "swim.mp4"
    with Video(path) as video:
        for _ in range(3):
            swimmer.step(np.array([0.3, 0.3, 0.3]))
            video.add(picture(swimmer, width=160))
            assert not path.exists()
    with av.open(str(path)) as file:
        assert sum(1 for _ in file.decode(video=0)) == 3
    with pytest.raises(RuntimeError), Video(tmp_path / "broken.mp4") as video:
        video.add(picture(swimmer, width=160))
        raise RuntimeError
    assert [p.name for p in tmp_path.iterdir()] == ["swim.mp4"]


def test_a_missing_folder_is_refused_at_once(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="swim"):
        Video(tmp_path / "file" / "swim.mp4")
