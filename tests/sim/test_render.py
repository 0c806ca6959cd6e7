"""Pictures and videos of a swim."""

import numpy as np
import pytest
from swimming_robots import FISH, in_a_box, with_effects

from sim.view.picture import depth, picture, plane_of, save_picture
from sim.view.video import Video
from sim2real.recording import POSE, Recording
from sim2real.viewers.scenes import axis_points

BOX = (0.9, 0.7, 0.4)


def fish(**more):
    return in_a_box(box_m=BOX, **more)


def test_a_viewer_shows_the_axis_where_the_links_are():
    swimmer = fish()
    swimmer.reset(pose=np.array([0.1, 0.05, 0.6]), joint=np.array([0.3, -0.5, 0.2]))
    state, links = swimmer.state(), plane_of(swimmer).links
    names = tuple(joint.name for joint in FISH.joints)
    columns = dict(zip(POSE, state.pose[:1].T, strict=True))
    swim = Recording("swim", "pool", names, np.zeros(1), state.joint, state.joint, columns=columns)
    _, points = axis_points(swim, FISH)
    joints = points[0, 1:-1, :2]  # the axis of the head starts behind its round front
    np.testing.assert_allclose(joints, links[1:, :2], atol=1e-9)


def test_a_current_carries_the_outline_along():
    swimmer = fish(model=with_effects(pool_current__u_m_s=0.2, pool_current__v_m_s=-0.1))
    for _ in range(50):
        swimmer.step(np.zeros(3))
    seen, (x, y, _) = plane_of(swimmer), swimmer.state().pose[0]
    assert depth(swimmer.hull, seen.links, np.array([x]), np.array([y]))[0] < -0.03
    assert seen.corner[0] < x < seen.corner[0] + BOX[0]
    assert np.hypot(*(np.array([x, y]) - seen.centre)) < 0.25
    assert seen.centre[0] > 0.1


def test_water_at_rest_is_white_and_a_vortex_has_its_sign():
    swimmer = fish()
    assert np.abs(plane_of(swimmer).vorticity).max() < 1e-6
    for _ in range(10):
        swimmer.step(np.array([0.6, 0.0, 0.0]))
    spin = plane_of(swimmer).vorticity
    assert spin.max() > 0.5
    assert spin.min() < -0.5


def test_the_robot_is_drawn_where_it_is_and_the_way_it_heads():
    swimmer = fish(walls=True)
    swimmer.reset(pose=np.array([0.15, -0.1, np.pi / 2]))
    image = picture(swimmer, width=360)  # 400 pixels of a metre, the world's origin in the middle
    row, column = image.shape[0] // 2 + 40, 180 + 60
    assert image[row, column].tolist() == [250, 247, 240]
    body = (image == [250, 247, 240]).all(axis=2)
    assert np.ptp(np.flatnonzero(body.any(axis=1))) > 2 * np.ptp(np.flatnonzero(body.any(axis=0)))


def test_a_picture_shows_the_robot_and_is_a_png(tmp_path):
    image = picture(fish(), width=320)
    assert image.shape[1] == 320
    assert image.shape[0] % 2 == 0
    dark = image.max(axis=2) < 150
    assert not (dark[:3].any() or dark[-3:].any() or dark[:, :3].any() or dark[:, -3:].any())
    assert all(part.any() for part in (dark[:40, :90], dark[-40:, :90], dark[-40:, -90:]))
    middle = image[image.shape[0] // 2, 160]
    assert middle.tolist() == [250, 247, 240]
    written = save_picture(image, tmp_path / "fish.png")
    assert written.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("ending", ["mp4", "avi", "gif"])
def test_a_video_appears_whole_or_not_at_all(tmp_path, ending):
    av = pytest.importorskip("av")
    swimmer, path = fish(), tmp_path / f"swim.{ending}"
    with Video(path) as video:
        for _ in range(3):
            swimmer.step(np.array([0.3, 0.3, 0.3]))
            last = picture(swimmer, width=160)
            video.add(last)
            assert not path.exists()
    with av.open(str(path)) as file:
        frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
    assert len(frames) == 3
    assert np.abs(frames[-1].astype(int) - last).mean() < 4
    with pytest.raises(RuntimeError), Video(tmp_path / f"broken.{ending}") as video:
        video.add(picture(swimmer, width=160))
        raise RuntimeError
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_a_video_is_streamed(tmp_path):
    """What is written grows while frames come, so that none has to be kept."""
    rng, size = np.random.default_rng(1), []
    with Video(tmp_path / "noise.gif") as video:
        for _ in range(20):
            video.add(rng.integers(0, 255, (240, 320, 3), dtype=np.uint8))
            size.append(next(tmp_path.iterdir()).stat().st_size)
    assert size[-1] > 1.5 * size[9] > 0
