"""The bus of foreign plants: rates, bursts, delays, order, and what the answers say of them."""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import skew

pytest.importorskip("numba", reason="generating cases needs numba")
pytest.importorskip("mujoco", reason="one of the plants is MuJoCo's")

ROOT = Path(__file__).parents[2] / "datasets"
FOLDERS = [ROOT / "foreign", ROOT / "concealed"]
COUNT = 200_000


@pytest.fixture(scope="module")
def code(scripts):
    """The generator's modules by name."""
    names = ("bus", "bus_answer", "foreign_cases", "foreign_world")
    with scripts(*FOLDERS, names=names) as modules:
        yield modules


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
