"""Foreign plants and their bus: reproducible, no answer in the inputs, servos that move as such."""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import skew

from sim2real.recording import read_recording
from sim2real.robot import match_joints, read_robot

pytest.importorskip("numba", reason="generating cases needs numba")
pytest.importorskip("mujoco", reason="one of the plants is MuJoCo's")

ROOT = Path(__file__).parents[2] / "datasets"
FOLDERS = [ROOT / "foreign", ROOT / "concealed"]
COUNT = 200_000


@pytest.fixture(scope="module")
def code(scripts):
    """The generator's modules by name."""
    names = (
        "make_foreign", "foreign_cases", "foreign_servos", "foreign_world", "bus", "bus_answer",
        "gear_plant", "mujoco_plant", "excitation",
    )  # fmt: skip
    with scripts(*FOLDERS, names=names) as modules:
        yield modules


@pytest.fixture(scope="module")
def challenge(code, tmp_path_factory):
    out = tmp_path_factory.mktemp("foreign") / "out"
    counts = {"null": 4, "single": 4, "double": 0, "outside": 0}
    plan = code["make_foreign"].plan(counts, np.random.default_rng(5))
    answers = [code["make_foreign"].make((out, 5, k, case, False)) for k, case in enumerate(plan)]
    return out, answers


def test_the_recordings_can_be_read_and_the_inputs_do_not_tell(challenge):
    out, answers = challenge
    for one in answers:
        folder = out / "inputs" / one["case"]
        robot = read_robot(folder / "robot.toml")
        for name in ("a", "b"):
            match_joints(read_recording(folder / f"{name}.csv"), robot)
        assert {path.stem for path in folder.iterdir()} <= {"a", "b", "robot", "model"}
        text = "".join(path.read_text() for path in folder.glob("*.json"))
        assert one["plant"] not in text
        assert not any(effect["effect"] in text for effect in one["effects"])


def test_the_same_seed_gives_the_same_case(challenge, code, tmp_path):
    out, answers = challenge
    one = answers[0]
    case = code["foreign_cases"].draw_case(*one["drawn"], np.random.default_rng(one["seed"]))
    seen = read_recording(out / "inputs" / one["case"] / "a.csv")
    assert seen.position == pytest.approx(case.takes["a"].measured, abs=1e-6, nan_ok=True)


@pytest.mark.parametrize("plant", ["mujoco", "voltage", "own", "gears"])
def test_a_plant_without_nuisances_is_a_proportional_servo(code, plant):
    """It starts late by its latency, is no faster than its motor, rests where torques balance."""
    rng = np.random.default_rng(3)
    servo = code["foreign_servos"].draw_servos(plant, rng)[0]
    servo.nuisances["ripple_Nm"] = 0.0
    t = np.arange(0.0, 4.0, 0.01)
    command = np.where(t < 1.0, 0.0, 0.4)[:, None]
    packets = code["bus"].draw_packets(code["bus"].Bus(), t.size, 1, rng)
    take = code["foreign_world"].Take(t, command, packets, 0.0)
    cases = code["foreign_cases"]
    case = cases.ForeignCase(plant, "null", [servo], [], {"a": take})
    q = case.readings("a", bent=False)[:, 0]
    rest, weight = q[-1], servo.loads["a"].gravity_Nm
    pull = servo.kp * (0.4 - rest)
    assert pull == pytest.approx(weight * np.sin(rest), abs=0.008 * servo.kp)
    assert np.abs(q[t < 1.0 + servo.latency_s - servo.read_s]).max() < 1e-6
    assert np.gradient(q, t).max() < 1.05 * servo.no_load_speed_rad_s


def _gear_servo(code, seed, **fields):
    """A servo that either plant of two masses can have, without nuisances."""
    servo = code["foreign_servos"].draw_servos("gears", np.random.default_rng(seed))[0]
    servo.nuisances["ripple_Nm"] = 0.0
    fields = {"loop_Hz": 2000.0, "firmware_damping": 0.3, "sensor_on_output": True, **fields}
    for name, value in fields.items():
        setattr(servo, name, value)
    return servo


@pytest.mark.parametrize("on_output", [False, True])
def test_two_plants_agree_on_backlash_with_friction_on_either_side(code, on_output):
    """MuJoCo's constraints and the semi-implicit steps of two masses."""
    t, grid = np.arange(0.0, 12.0, 0.01), np.arange(0.0, 12.0, 1e-3)
    command = code["excitation"].signal("a", t, np.random.default_rng(2), 12.0)

    def angle(plant, side):
        servo = _gear_servo(code, 2, dry_friction_Nm=0.06, friction_on_output=side)
        acting = {"backlash": {"gap_rad": 0.02}}
        return code[plant].simulate(servo, servo.loads["a"], acting, grid, t, command, [])

    def rms(difference):
        return float(np.sqrt(np.mean(difference**2)))

    ours = angle("gear_plant", on_output)
    assert rms(angle("mujoco_plant", on_output) - ours) < 5e-4
    assert rms(angle("gear_plant", not on_output) - ours) > 2e-3


def test_a_backlash_with_friction_states_the_friction_as_a_nuisance(code):
    name, rng = "backlash_output_friction", np.random.default_rng(2)
    case = code["foreign_cases"].draw_case("gears", "single", name, rng)
    assert [hidden.effect for hidden in case.hidden] == ["backlash"]
    assert all(servo.friction_on_output for servo in case.servos)
    friction = [
        n["parameters"]["torque_Nm"]
        for n in code["foreign_cases"].nuisances(case) if n["effect"] == "coulomb_friction"
    ]  # fmt: skip
    assert friction == [servo.dry_friction_Nm for servo in case.servos]
    assert min(friction) > 0.01


@pytest.mark.parametrize("plant", ["mujoco", "gears"])
def test_a_current_limited_drive_is_clipped_at_any_speed(code, plant):
    """From rest, a large step accelerates as the stall torque less the damping does."""
    servo = _gear_servo(code, 1, kp=4.0, firmware_damping=0.6, stall_Nm=1.0)
    load = servo.loads["a"]
    servo.kd = 0.02
    grid, command = np.arange(0.0, 0.1, 1e-3), np.array([1.5])
    q = (
        code["foreign_cases"]
        .SIMULATORS[plant]
        .simulate(servo, load, {}, grid, np.array([0.0]), command, [])
    )
    damping, inertia = 0.4 * servo.kd, load.inertia_kgm2
    t, early = grid, grid < 0.03
    free = servo.stall_Nm / damping * (t - inertia / damping * (1 - np.exp(-damping / inertia * t)))
    assert q[early] == pytest.approx(free[early], rel=0.05, abs=2e-3)


@pytest.fixture(scope="module")
def packets(code):
    """Packets to two joints on a bus with some properties."""

    def draw(count=COUNT, **properties):
        bus = code["bus"].Bus(**properties)
        return code["bus"].draw_packets(bus, count, 2, np.random.default_rng(8))

    return draw


@pytest.mark.parametrize("burst", [0.0, 2.0, 6.0])
@pytest.mark.parametrize("probability", [0.005, 0.03])
def test_losses_have_their_long_run_rate_and_mean_burst(packets, burst, probability):
    lost = packets(burst_packets=burst).lost(0, probability)
    bursts = np.count_nonzero(np.diff(lost.astype(int)) == 1)
    mean = burst or 1 / (1 - probability)
    spread = np.sqrt(2 * mean / (probability * COUNT))  # of the rate, relative
    assert lost.mean() == pytest.approx(probability, rel=4 * spread)
    assert lost.sum() / bursts == pytest.approx(mean, rel=4 * spread)


@pytest.mark.parametrize("correlation", [0.0, 4.0])
@pytest.mark.parametrize(
    ("delay", "skewness"), [("uniform", 0), ("gamma", 2**0.5), ("exponential", 2)]
)
def test_delays_have_their_distribution(packets, delay, skewness, correlation):
    added = packets(delay=delay, correlation_packets=correlation).delay[:, 0]
    assert added.mean() == pytest.approx(0.0, abs=0.03)
    assert added.std() == pytest.approx(1.0, abs=0.03)
    assert skew(added) == pytest.approx(skewness, abs=0.15)
    neighbours = np.corrcoef(added[1:], added[:-1])[0, 1]
    assert (neighbours > 0.6) if correlation else (abs(neighbours) < 0.02)


def test_a_queue_keeps_order_and_else_packets_overtake(packets):
    sent = 0.005 * np.arange(2000)
    for in_order in (True, False):
        drawn = packets(2000, delay="exponential", in_order=in_order)
        arrival = sent + 0.02 + 0.007 * drawn.delay[:, 0]
        received, when = drawn.delivered(arrival, 0, 0.02)
        lost = drawn.lost(0, 0.02)
        assert set(received) == set(np.flatnonzero(~lost))
        assert (np.diff(when) >= 0).all()
        assert (when >= arrival[received] - 1e-12).all()
        if in_order:
            assert (np.diff(received) > 0).all()
            assert (when > arrival[received] + 1e-3).any()
        else:
            assert (np.diff(received) < 0).mean() > 0.1
            assert when == pytest.approx(arrival[received])


@pytest.mark.parametrize("effect", ["latency_jitter", "packet_loss"])
def test_the_answers_say_when_each_event_happened(code, effect):
    """The same seed draws the same events; the events of the answers explain the readings."""
    case, again = (
        code["foreign_cases"].draw_case("voltage", "single", effect, np.random.default_rng([3, 9]))
        for _ in range(2)
    )
    answer = code["bus_answer"].bus_answer(case)
    assert answer == code["bus_answer"].bus_answer(again)
    assert len(case.servos) > 1
    for recording, joints in answer["events"].items():
        take = case.takes[recording]
        for j, events in enumerate(joints.values()):
            assert take.measured[:, j] == pytest.approx(
                again.takes[recording].measured[:, j], nan_ok=True
            )
            probability = case.hidden[0].parameters.get("probability", 0.0)
            assert events["lost_s"] == take.t[take.packets.lost(j, probability)].tolist()
            if effect == "latency_jitter":
                assert np.std(events["delay_s"]) > 0.3 * answer["added_delay_standard_deviation_s"]
        if answer["packets"] == "common":
            assert len({str(events["lost_s"]) for events in joints.values()}) == 1
