"""A lens from rendered views of a board, and the tracker on a rendered pool: other renderers."""

import numpy as np
import pytest

from sim2real.cli import main
from sim2real.commands.camera import board_of
from sim2real.errors import InputError
from sim2real.hardware.camera import Blob, Camera, Lens, Marker, read_camera, stand, write_camera
from sim2real.hardware.tracker import Track, correlated, joined, track
from sim2real.recording import Recording, read_recording, write_recording

cv2 = pytest.importorskip("cv2", reason="the extra 'hardware' is not installed")
overhead = pytest.importorskip("overhead")

RATE = 30.0
TIMES = np.arange(40) / RATE + 2.0
HIDDEN = (2.5, 2.7)
CORNERS = np.array([[0.0, 0.0], [3.6, 0.0], [3.6, 3.6], [0.0, 3.6]])
MARKER = Marker("4x4_50", 3, 0.06, 0.05)


def seen_corners(shot):
    return shot.eye.pixels(np.column_stack([CORNERS, np.zeros(4)]))


def lens_of(shot):
    (fx, fy), (cx, cy) = shot.eye.focal, shot.eye.centre
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    return Lens(overhead.SIZE, matrix, np.array(shot.eye.lens), 0.2)


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """A video, its first four frames, and the camera's file."""
    folder, shot = tmp_path_factory.mktemp("film"), overhead.Shot()
    pictures = [*overhead.frames(shot, TIMES, rng=np.random.default_rng(0), hidden=HIDDEN)]
    videos = (
        overhead.write_video(folder / f"{name}.avi", frames, RATE)
        for name, frames in (("swim", pictures), ("brief", pictures[:4]))
    )
    toml = folder / "camera.toml"
    write_camera(toml, lens_of(shot), seen_corners(shot), CORNERS, MARKER)
    return *videos, toml


def errors(found, truth):
    off = found - truth
    off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return np.hypot(off[:, 0], off[:, 1]), off[:, 2]


def changed(toml, folder, old, new):
    text = toml.read_text()
    assert old in text
    (folder / "camera.toml").write_text(text.replace(old, new))
    return folder / "camera.toml"


def test_a_rendered_swim_is_tracked(filmed, tmp_path):
    video, _, toml = filmed
    out = tmp_path / "alone.csv"
    call = ["track", str(video), "--camera", str(toml), "--joints", "a", "b", "--out", str(out)]
    assert main(call) == 0
    recording = read_recording(out)
    assert recording.joints == ("a", "b")
    pose = np.column_stack([recording.columns[f"body.{x}"] for x in ("x_m", "y_m", "yaw_rad")])
    hidden = np.abs(TIMES - np.mean(HIDDEN)) < np.ptp(HIDDEN) / 2
    hidden |= np.isclose(TIMES, HIDDEN[0])
    seen = np.isfinite(pose).all(axis=1)
    assert np.array_equal(seen, ~hidden), "seen whenever it can be, and only then"
    away, turned = errors(pose[~hidden], overhead.swim(TIMES)[~hidden])
    assert np.sqrt(np.mean(away**2)) <= 0.003
    assert np.sqrt(np.mean(turned**2)) <= np.deg2rad(0.5)


def test_the_command_writes_a_recording_and_a_picture(filmed, tmp_path, capsys):
    video, brief, toml = filmed
    t = np.arange(0.0, 1.2, 0.02)
    servo = tmp_path / "servo.csv"
    angle = 0.1 * np.sin(5 * t)[:, None]
    write_recording(Recording("servo", "servo", ("j1",), t, 0.1 + 0 * angle, angle), servo)
    out = tmp_path / "swim.csv"
    call = ["--camera", str(toml), "--servo", str(servo)]
    assert main(["track", str(video), *call, "--out", str(out), "--sync", "0.0"]) == 0
    recording = read_recording(out)
    assert recording.kind == "pool"
    truth = overhead.swim(t + TIMES[0])
    x = recording.columns["body.x_m"]
    hidden = (t + TIMES[0] > HIDDEN[0]) & (t + TIMES[0] < HIDDEN[1] - 1 / RATE)
    assert np.isnan(x[hidden]).all(), "missing frames stay missing"
    there = np.isfinite(x)
    assert there.mean() > 0.75
    assert np.abs(x[there] - truth[there, 0]).max() < 0.003
    assert out.with_suffix(".png").stat().st_size > 5000
    assert "seen in 34 of 40 frames" in capsys.readouterr().out
    no = ["--out", str(tmp_path / "no.csv"), "--sync", "noon"]
    assert main(["track", str(brief), *call, *no]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_blob_will_do(tmp_path):
    shot = overhead.Shot(blob=True, samples=4)
    t = TIMES[:12]
    pictures = overhead.frames(shot, t, rng=np.random.default_rng(1))
    video = overhead.write_video(tmp_path / "blob.avi", pictures, RATE)
    plane = stand(lens_of(shot), seen_corners(shot), CORNERS)
    blob = Blob(np.array([4.0, 120.0, 80.0]), np.array([22.0, 255.0, 255.0]), 0.05)
    found = track(video, Camera(plane, CORNERS, None, blob))
    away, turned = errors(found.pose, overhead.swim(t))
    assert np.sqrt(np.mean(away**2)) < 0.006
    assert np.sqrt(np.mean(turned**2)) < np.deg2rad(5)


def test_a_camera_is_read_back_as_written(filmed):
    camera = read_camera(filmed[-1])
    points = np.array([[0.3, 0.4], [3.0, 2.0], [1.8, 1.8]])
    seen = overhead.Eye().pixels(np.column_stack([points, np.full(3, 0.05)]))
    assert np.allclose(camera.plane.raised(0.05).pixels(points), seen, atol=0.01)
    assert np.allclose(camera.plane.raised(0.05).world(seen), points, atol=1e-4)
    assert camera.marker == MARKER


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[lens]", "[glass]", "lens"),
        ('"4x4_50"', '"4x4_51"', "marker.dictionary"),
        ("number = 3", "number = 50", "marker.number"),
        ("distortion = [", "distortion = [1.0, ", "lens.distortion"),
        ("side_m = 0.06", "side_m = 0.0", "marker.side_m"),
    ],
)
def test_a_spoilt_camera_file_is_refused(filmed, tmp_path, old, new, said):
    with pytest.raises(InputError, match=said):
        read_camera(changed(filmed[-1], tmp_path, old, new))


def test_a_video_without_the_marker_is_refused(filmed, tmp_path):
    _, brief, toml = filmed
    with pytest.raises(InputError, match="no marker"):
        track(brief, read_camera(changed(toml, tmp_path, "number = 3", "number = 7")))
    with pytest.raises(InputError, match="no video"):
        track(tmp_path / "none.avi", read_camera(toml))


def motion(start: float, rng: np.random.Generator) -> tuple[Track, Recording]:
    """A camera at 30 Hz and servos at 50 Hz that began ``start`` seconds before the camera."""
    t = np.arange(0, 14, 0.02)

    def joints(x):
        return np.stack([0.4 * np.sin(5 * x + 0.3 * x**1.5), 0.3 * np.cos(7 * x + x**1.2)], axis=1)

    yaw_t = np.arange(0, 9, 1 / RATE)
    yaw = -joints(yaw_t + start) @ [0.4, -0.2] + 0.2 * yaw_t
    pose = np.column_stack([0.1 * yaw_t, 0 * yaw_t, yaw]) + rng.normal(0, 0.004, (yaw_t.size, 3))
    servo = Recording("s", "servo", ("a", "b"), t, joints(t), joints(t))
    return Track(yaw_t, pose), servo


@pytest.mark.parametrize("start", [0.0, 1.234, 3.7])
def test_the_clocks_are_found_within_a_frame(start):
    seen, servo = motion(start, np.random.default_rng(2))
    found, share = correlated(seen, servo)
    assert abs(found - start) < 1 / RATE
    assert share > 0.5
    columns = joined(seen, servo, found)
    inside = (servo.t > start + 0.1) & (servo.t < start + 8.9)
    assert np.isfinite(columns["body.yaw_rad"][inside]).all()
    assert np.isnan(columns["body.yaw_rad"][servo.t > start + 9.1]).all()


SPEC = "7,5,0.04,0.03"
BOARD = board_of(SPEC, "4x4_50")


def view(rays, turn, centre, rng):
    """The board at ``centre`` before the camera, turned, as each pixel's ray meets it."""
    sheet = BOARD.generateImage((700, 500), marginSize=0)
    rotation = cv2.Rodrigues(np.array(turn, dtype=float))[0]
    normal = rotation[:, 2]
    reach = (np.array(centre) @ normal) / (rays @ normal)
    spots = (rays * reach[..., None] - np.array(centre)) @ rotation
    x, y = spots[..., 0] / 0.04 + 3.5, spots[..., 1] / 0.04 + 2.5
    inside = (x >= 0) & (x < 7) & (y >= 0) & (y < 5) & (reach > 0)
    grey = cv2.remap(
        sheet, (x * 100).astype(np.float32), (y * 100).astype(np.float32), cv2.INTER_AREA
    )
    picture = np.where(inside, grey, 150).astype(np.float32)
    picture = cv2.GaussianBlur(picture, (0, 0), 0.7) + rng.normal(0, 2, picture.shape)
    return picture.clip(0, 255).astype(np.uint8)


def test_a_lens_is_found(tmp_path, capsys):
    eye, rng = overhead.Eye(), np.random.default_rng(0)
    v, u = np.mgrid[0 : overhead.SIZE[1], 0 : overhead.SIZE[0]].astype(float)
    rays, places = eye.rays(u, v), []
    for k in range(14):
        turn = rng.uniform(-0.5, 0.5, 3)
        centre = (rng.uniform(-0.13, 0.13), rng.uniform(-0.09, 0.09), rng.uniform(0.28, 0.4))
        places.append(tmp_path / f"{k:02d}.png")
        cv2.imwrite(str(places[-1]), view(rays, turn, centre, rng))
    seen = eye.pixels(np.array([[0, 0, 0], [3.6, 0, 0], [3.6, 3.6, 0], [0, 3.6, 0]], dtype=float))
    out = tmp_path / "camera.toml"
    corners = [f"{u:.2f},{v:.2f}" for u, v in seen]
    call = ["calibrate-camera", *map(str, places), "--board", SPEC, "--corners", *corners]
    assert main([*call, "--out", str(out)]) == 0, capsys.readouterr().err
    plane = read_camera(out).plane
    assert np.allclose(np.diag(plane.lens.matrix)[:2], eye.focal, rtol=0.01)
    assert np.allclose(plane.lens.matrix[:2, 2], eye.centre, atol=4)
    assert plane.lens.rms_px < 0.5
    assert np.allclose(plane.position, eye.position, atol=0.04)
    few = [*call[:4], *call[15:]]
    assert main([*few, "--out", str(tmp_path / "no.toml")]) == 2
    assert "views of the board" in capsys.readouterr().err
    assert not (tmp_path / "no.toml").exists()
