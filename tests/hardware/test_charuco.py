"""A lens from rendered views of a board: another renderer than OpenCV's own projection."""

import numpy as np
import pytest

from sim2real.cli import main
from sim2real.commands.camera import board_of
from sim2real.hardware.camera import read_camera

cv2 = pytest.importorskip("cv2", reason="the extra 'hardware' is not installed")
overhead = pytest.importorskip("overhead")

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
