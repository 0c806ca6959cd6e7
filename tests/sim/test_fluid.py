import json

import numpy as np
import pytest

from benchmarks.validation import slender, swimmers
from benchmarks.validation.__main__ import main
from benchmarks.validation.case import Where
from benchmarks.validation.still import vortices
from benchmarks.validation.streams import cavity
from sim.fluid.fluid import Fluid
from sim.lattice.cell import MOVING, SLIP, SOLID
from sim.lattice.velocities import D2Q9, D3Q19
from sim2real.errors import InputError

SIZES = {D2Q9: (18, 14), D3Q19: (9, 8, 7)}
BOTH = pytest.mark.parametrize("lattice", [D2Q9, D3Q19], ids=lambda one: one.name)


def waves(size, speed=0.05, seed=0, modes=3):
    """A smooth periodic density and velocity with no symmetry."""
    rng = np.random.default_rng(seed)
    size = (*size, 1) if len(size) == 2 else size
    grid = np.indices(size) / np.array(size).reshape(3, 1, 1, 1)
    total = np.zeros((4, *size))
    for _ in range(modes):
        k, phase = rng.integers(-1, 2, 3), rng.uniform(0, 2 * np.pi, (4, 1, 1, 1))
        total += np.sin(2 * np.pi * np.tensordot(k, grid, 1) + phase)
    total *= speed / np.abs(total).max()
    u = np.moveaxis(total[1:], 0, -1)
    if size[2] == 1:
        u[..., 2] = 0
    return 1 + 0.2 * total[0], u


@BOTH
@pytest.mark.parametrize("steps", [1, 2, 51])
def test_what_is_set_is_read_back_and_conserved(lattice, steps):
    fluid = Fluid(lattice, SIZES[lattice], viscosity=0.01)
    density, u = waves(fluid.size)
    fluid.set(density, u)
    before = fluid.moments()
    assert np.allclose(before[0][0], density, atol=1e-6)
    assert np.allclose(before[1][0], u, atol=1e-6)
    fluid.step(steps)
    after = fluid.moments()
    cells = density.size
    assert abs((after[0] - before[0]).sum(dtype=float)) < 2e-7 * cells
    momenta = [(r[..., None] * v).sum(axis=(0, 1, 2, 3), dtype=float) for r, v in (before, after)]
    assert np.abs(momenta[1] - momenta[0]).max() < 2e-7 * cells
    assert np.abs(after[1] - before[1]).max() > 1e-4


@BOTH
def test_flow_between_walls_is_the_parabola_whatever_the_viscosity(lattice):
    width, force = 6, 1e-5
    walls = np.zeros((3, width + 1, 1 if lattice is D2Q9 else 2), np.uint8)
    walls[:, 0] = SOLID
    for viscosity in (0.05, 0.3):
        fluid = Fluid(lattice, walls.shape, viscosity=viscosity, walls=walls)
        fluid.accelerate(np.array([force, 0, 0]))
        fluid.step(round(14 * width**2 / viscosity / np.pi**2))
        u = fluid.moments()[1][0, 0, 1:, 0, 0]
        y = np.arange(width) + 0.5
        exact = force / 2 / viscosity * y * (width - y)
        # the force acts between collisions: half of it is not yet in what is read
        assert np.allclose(u + force / 2, exact, rtol=3e-4)


@BOTH
def test_a_moving_wall_drags_the_fluid_along(lattice):
    """Couette's flow: linear from the wall at rest to the one that moves, both half-way."""
    width, speed, viscosity = 8, 0.05, 0.1
    walls = np.zeros((3, width + 2, 1 if lattice is D2Q9 else 2), np.uint8)
    walls[:, 0], walls[:, -1] = SOLID, MOVING
    velocity = np.zeros((*walls.shape, 3), np.float32)
    velocity[:, -1, :, 0] = speed
    fluid = Fluid(lattice, walls.shape, viscosity=viscosity, walls=walls, wall_velocity=velocity)
    fluid.step(round(8 * width**2 / viscosity / np.pi**2))
    u = fluid.moments()[1][0, 0, 1:-1, 0]
    exact = speed * (np.arange(width) + 0.5) / width
    assert np.allclose(u[:, 0], exact, rtol=0.02)
    assert np.abs(u[:, 1:]).max() < 1e-6


@pytest.mark.parametrize("out, along", [(0, 1), (1, 2), (2, 0), (1, 0)])
def test_free_slip_walls_are_mirrors(out, along):
    """Half of a box of vortices, cut where nothing crosses, goes on as in the whole box."""
    n, speed = 16, 0.02
    shape = np.ones(3, int)
    shape[[out, along]] = n
    grid = 2 * np.pi / n * (np.indices(shape) + 0.5)
    u = np.zeros((*shape, 3))
    u[..., out] = speed * np.sin(grid[out]) * np.cos(grid[along])
    u[..., along] = -speed * np.cos(grid[out]) * np.sin(grid[along])
    u[..., 3 - out - along] = speed * np.cos(grid[out])
    half = [slice(0, n // 2) if k == out else slice(None) for k in range(3)]
    size = shape.copy()
    size[out] = n // 2 + 2
    walls, normals = np.zeros(size, np.uint8), np.zeros(size, np.int32)
    start = np.zeros((*size, 3))
    inner = tuple(slice(1, -1) if k == out else slice(None) for k in range(3))
    start[inner] = u[tuple(half)]
    for end, normal in ((0, 2 * out + 1), (-1, 2 * out)):
        np.moveaxis(walls, out, 0)[end] = SLIP
        np.moveaxis(normals, out, 0)[end] = normal
    whole = Fluid(D3Q19, shape, viscosity=0.05)
    closed = Fluid(D3Q19, size, viscosity=0.05, walls=walls, normals=normals)
    for fluid, velocity in ((whole, u), (closed, start)):
        fluid.set(velocity=velocity)
        fluid.step(60)
    error = whole.moments()[1][0][tuple(half)] - closed.moments()[1][0][inner]
    assert np.abs(error).max() < 1e-4 * np.abs(whole.moments()[1]).max()


@BOTH
def test_turning_and_mirroring_the_start_turns_and_mirrors_the_flow(lattice):
    size = (9, 9) if lattice is D2Q9 else (7, 7, 7)
    density, u = waves(size)
    plain = Fluid(lattice, size, viscosity=0.02)
    plain.set(density, u)
    plain.step(30)
    ours = plain.moments()[1][0]

    def turned(x):  # a quarter turn in the plane xy
        x = np.rot90(x, axes=(0, 1))
        return np.stack([-x[..., 1], x[..., 0], x[..., 2]], axis=-1)

    def mirrored(x):
        return np.flip(x, 0) * np.array([-1, 1, 1])

    for change, field in ((turned, np.rot90(density)), (mirrored, np.flip(density, 0))):
        changed = Fluid(lattice, size, viscosity=0.02)
        changed.set(field, change(u))
        changed.step(30)
        assert np.allclose(changed.moments()[1][0], change(ours), atol=3e-7)


@BOTH
def test_a_stream_carries_vortices_along_unchanged(lattice):
    """Galilean invariance, but for the third power of the speed that such lattices lack."""
    n, steps, carried = 32, 160, {}
    density, u, strain = vortices(n, 0.0, (0, 1))
    for stream in (0.0, 0.05, 0.1):
        fluid = Fluid(lattice, (n, n, 1), viscosity=0.02)
        fluid.set(density, u + np.array([stream, 0, 0]), strain)
        fluid.step(steps)
        moved = np.exp(-2j * np.pi * np.fft.fftfreq(n) * -stream * steps)
        v = fluid.moments()[1][0, :, :, 0, 1]
        carried[stream] = np.fft.ifft(moved[:, None] * np.fft.fft(v, axis=0), axis=0).real
    size = np.abs(carried[0.0]).max()
    errors = [np.abs(carried[s] - carried[0.0]).max() / size for s in (0.05, 0.1)]
    assert errors[0] < 0.01
    assert errors[1] < 0.03


def test_the_cavity_is_the_published_one():
    assert [one.quantity for one in cavity(Where(quick=True)).figures if not one.met] == []


@BOTH
def test_threads_make_no_difference(lattice):
    size = (96, 64) if lattice is D2Q9 else (24, 18, 12)
    ends = []
    for threads in (1, 2):
        fluid = Fluid(lattice, size, viscosity=0.02, threads=threads)
        fluid.set(*waves(fluid.size))
        fluid.step(15)
        ends.append(fluid.f.numpy())
    assert np.array_equal(*ends)


def test_a_cell_that_is_too_fast_stops_its_own_box_and_is_named():
    size = (12, 10, 8)
    fluid = Fluid(D3Q19, size, viscosity=0.02, boxes=3)
    density, u = waves(size)
    u = np.stack([u, u, u])
    u[1, 4, 3, 2] = [0.6, 0, 0]
    fluid.set(density, u)
    fluid.step(25)
    assert fluid.stopped.numpy().tolist() == [-1, 4 + 12 * (3 + 10 * 2), -1]
    ours = fluid.moments()[1]
    alone = Fluid(D3Q19, size, viscosity=0.02)
    alone.set(density, u[:1])
    alone.step(25)
    assert np.array_equal(ours[0], alone.moments()[1][0])
    assert np.array_equal(ours[2], ours[0])
    fluid.set(density, u[0])
    assert fluid.stopped.numpy().tolist() == [-1, -1, -1]


@pytest.mark.parametrize(
    "more, where", [({"viscosity": 0.0}, "viscosity"), ({"viscosity": 0.1, "boxes": 10**7}, "size")]
)
def test_what_cannot_be_simulated_is_refused_by_name(more, where):
    with pytest.raises(InputError) as caught:
        Fluid(D2Q9, (16, 16), **more)
    assert caught.value.where == where


@pytest.mark.parametrize(
    ("k", "thrust", "power"), [(2.0, 0.047, 0.123), (3.0, 0.124, 0.277), (4.0, 0.232, 0.493)]
)
def test_a_thin_foil_has_garricks_thrust_and_power(k, thrust, power):
    assert swimmers.garrick(k) == pytest.approx((thrust, power), abs=5e-4)


def test_a_section_is_as_thick_as_its_digits_say():
    hull, nose = swimmers.section(0.4, 0.21)
    assert 2 * hull.half_width.max() == pytest.approx(0.21 * 0.4, rel=0.01)
    assert nose + hull.length.sum() == pytest.approx(0.995 * 0.4)
    assert hull.half_width[1:, 0] == pytest.approx(hull.half_width[:-1, 2])


def test_a_pitching_foil_has_thrust_and_takes_power():
    rest, _ = swimmers.coefficients(12, lengths=1.0)
    drag, _ = swimmers.coefficients(12, k=3.0, lengths=1.0)
    thrust, _ = swimmers.garrick(3.0)
    assert 0.4 * thrust < rest - drag < 1.2 * thrust
    small = {"k": 3.0, "pitch_rad": 0.04}  # the power of larger amplitudes is not linear theory's
    _, power = swimmers.coefficients(12, **small, lengths=1.0)
    _, needed = swimmers.garrick(small["k"], small["pitch_rad"])
    assert power == pytest.approx(needed, rel=0.3)


def test_a_plate_that_moves_on_has_the_pressure_drag_of_a_blunt_body():
    """Three sides of way: far above that of a streamlined body, of the order of Hoerner's."""
    moved, found = slender.plate_drag(6, lengths=3.0)
    assert found[moved > 1.5].mean() == pytest.approx(slender.SQUARE, rel=0.5)


def test_references_of_spheroids_are_the_published_ones():
    """Lamb's table for a fineness of 6.01, end-on and broadside."""
    assert slender.carried(6.01) == pytest.approx((0.045, 0.918), abs=1e-3)
    assert slender.slipping() == pytest.approx(1.0572, abs=1e-4)
    assert slender.slipping(1e3) == pytest.approx(1.0, abs=1e-3)  # a needle is a plate
    assert slender.plate_friction(1e7) == pytest.approx(0.003, rel=1e-9)


def test_a_slipping_spheroid_carries_the_water_that_lamb_says(monkeypatch):
    """After one period of shaking; towed a tenth of its length, as friction has no bar."""
    monkeypatch.setattr(slender, "_PERIODS", 1)
    monkeypatch.setattr(slender, "_LENGTHS", 0.1)
    case = slender.spheroid(Where(quick=True))
    mass = case.figures[0]
    assert mass.reference == pytest.approx(1.0452, abs=1e-4)
    assert mass.met, mass
    assert all(figure.bar is None for figure in case.figures[1:])


def test_the_program_prints_figures_and_writes_a_page(tmp_path, capsys):
    page = tmp_path / "validation.html"  # its exit status is 1 if a figure is not met
    assert main(["--quick", "--only", "taylor_green", "--out", str(page)]) == 0
    printed = capsys.readouterr().out
    assert "order of convergence" in printed and "met" in printed
    assert "order of convergence" in page.read_text()
    case = json.loads(page.with_suffix(".json").read_text())["cases"][0]
    assert case["name"] == "taylor_green"
