"""The makers' own software talks to the virtual servos, over a pseudo-terminal."""

import time
from types import SimpleNamespace

import pytest
from virtual_bench import served

MODELS = {
    # software, bus, protocol, number, centre, addresses of torque, goal and position, their size
    "XL330-M288": ("dynamixel_sdk", "dynamixel", 2.0, 1200, 2048, 64, 116, 132, 4),
    "STS3215": ("scservo_sdk", "feetech", 0, 777, 2048, 40, 42, 56, 2),
}
NAMES = ("version", "number", "centre", "torque", "goal", "position", "size")


@pytest.fixture
def bench(request, monkeypatch):
    """Three servos of a model, and the makers' software on their port, patient on a busy machine.

    It gives up 34 ms after a request, which a thread of a busy machine may not see for longer.
    """
    software, bus, *given = MODELS[request.param]
    sdk = pytest.importorskip(software, reason=f"no extra 'dev': {software}")
    monkeypatch.setattr(sdk.port_handler, "LATENCY_TIMER", 250)
    one = SimpleNamespace(**dict(zip(NAMES, given, strict=True)), sdk=sdk, model=request.param)
    with served(3, bus=bus, model=request.param) as one.bench:
        one.port, one.packets = sdk.PortHandler(one.bench.port), sdk.PacketHandler(one.version)
        assert one.port.openPort() and one.port.setBaudRate(1_000_000)
        one.read = getattr(one.packets, f"read{one.size}ByteTxRx")
        one.write = getattr(one.packets, f"write{one.size}ByteTxRx")
        yield one
        one.port.closePort()


@pytest.mark.parametrize("bench", MODELS, indirect=True)
def test_servos_are_found_moved_and_read(bench):
    sdk, port, packets, done = bench.sdk, bench.port, bench.packets, bench.sdk.COMM_SUCCESS
    assert packets.ping(port, 2) == (bench.number, done, 0)
    assert packets.ping(port, 9)[1] == sdk.COMM_RX_TIMEOUT
    assert bench.read(port, 1, bench.position) == (bench.centre, done, 0)
    goals = {k: bench.centre + 40 * k - 140 for k in (1, 2, 3)}
    for k in goals:
        assert packets.write1ByteTxRx(port, k, bench.torque, 1) == (done, 0)
        assert bench.bench.servos[k - 1].powered
    assert bench.write(port, 1, bench.goal, goals[1]) == (done, 0)
    several = sdk.GroupSyncWrite(port, packets, bench.goal, bench.size)
    for k in (2, 3):
        several.addParam(k, goals[k].to_bytes(bench.size, "little"))
    several.txPacket()
    time.sleep(0.6)
    for k in goals:
        assert abs(bench.read(port, k, bench.position)[0] - goals[k]) <= 2
    present = sdk.GroupSyncRead(port, packets, bench.position, bench.size)
    for k in (3, 1, 2):
        present.addParam(k)
    assert present.txRxPacket() == done
    for k in goals:
        assert abs(present.getData(k, bench.position, bench.size) - goals[k]) <= 2


@pytest.mark.parametrize("bench", ["XL330-M288"], indirect=True)
def test_what_a_dynamixel_refuses(bench):
    port, packets, done = bench.port, bench.packets, bench.sdk.COMM_SUCCESS
    assert packets.broadcastPing(port) == ({k: [1200, 46] for k in (1, 2, 3)}, done)
    assert packets.write4ByteTxRx(port, 1, 112, 0x00FDFFFF) == (done, 0), "stuffed"
    assert packets.read4ByteTxRx(port, 1, 112) == (0x00FDFFFF, done, 0)
    assert packets.write1ByteTxRx(port, 1, 64, 7) == (done, 4), "out of range"
    assert packets.write4ByteTxRx(port, 1, 132, 0) == (done, 7), "read-only"
    assert packets.write1ByteTxRx(port, 1, 64, 1) == (done, 0)
    assert packets.write1ByteTxRx(port, 1, 11, 1) == (done, 7), "EEPROM while powered"


@pytest.mark.parametrize("bench", ["XL330-M288"], indirect=True)
def test_a_bus_watchdog_stops_the_servo_until_it_is_cleared(bench):
    port, packets, done = bench.port, bench.packets, bench.sdk.COMM_SUCCESS
    packets.write1ByteTxRx(port, 1, 64, 1)
    assert packets.write1ByteTxRx(port, 1, 98, 2) == (done, 0)
    time.sleep(0.15)
    assert packets.read1ByteTxRx(port, 1, 98)[0] == 255
    assert packets.write4ByteTxRx(port, 1, 116, 2000) == (done, 4)
    assert packets.write1ByteTxRx(port, 1, 98, 0) == (done, 0)
    assert packets.write4ByteTxRx(port, 1, 116, 2000) == (done, 0)


@pytest.mark.parametrize(
    ("bench", "bits"), [("XL330-M288", 128), ("STS3215", 4)], indirect=["bench"]
)
def test_error_bytes_tell_heat(bench, bits):
    bench.bench.servos[0]._temperature_C = 90
    bench.read(bench.port, 1, bench.position)  # the present values are those of the last read
    assert bench.packets.ping(bench.port, 1)[2] == bits
