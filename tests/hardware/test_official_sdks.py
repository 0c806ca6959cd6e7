"""The makers' own software talks to the virtual servos, over a pseudo-terminal."""

import time

import pytest
from virtual_bench import served


@pytest.fixture
def dynamixels():
    sdk = pytest.importorskip("dynamixel_sdk", reason="no extra 'dev': dynamixel-sdk")
    with served(3, bus="dynamixel") as bench:
        port = sdk.PortHandler(bench.port)
        assert port.openPort() and port.setBaudRate(1_000_000)
        yield sdk, port, sdk.PacketHandler(2.0), bench
        port.closePort()


@pytest.fixture(params=["STS3215", "SCS0009"])
def feetechs(request):
    sdk = pytest.importorskip("scservo_sdk", reason="no extra 'dev': feetech-servo-sdk")
    with served(3, bus="feetech", model=request.param) as bench:
        port = sdk.PortHandler(bench.port)
        assert port.openPort() and port.setBaudRate(1_000_000)
        scs = request.param.startswith("SCS")
        yield sdk, port, sdk.PacketHandler(int(scs)), bench, scs
        port.closePort()
        sdk.scservo_def.SCS_SETEND(0)


def test_dynamixel_sdk_pings_reads_and_writes(dynamixels):
    sdk, port, packets, bench = dynamixels
    assert packets.ping(port, 2) == (1200, sdk.COMM_SUCCESS, 0)
    assert packets.ping(port, 9)[1] == sdk.COMM_RX_TIMEOUT
    found, result = packets.broadcastPing(port)
    assert result == sdk.COMM_SUCCESS
    assert found == {k: [1200, 46] for k in (1, 2, 3)}
    assert packets.read4ByteTxRx(port, 1, 132) == (2048, sdk.COMM_SUCCESS, 0)
    assert packets.read1ByteTxRx(port, 1, 146) == (30, sdk.COMM_SUCCESS, 0)
    assert packets.write4ByteTxRx(port, 1, 112, 0x00FDFFFF) == (sdk.COMM_SUCCESS, 0), "stuffed"
    assert packets.read4ByteTxRx(port, 1, 112) == (0x00FDFFFF, sdk.COMM_SUCCESS, 0)
    assert packets.write1ByteTxRx(port, 1, 64, 7) == (sdk.COMM_SUCCESS, 4), "out of range"
    assert packets.write4ByteTxRx(port, 1, 132, 0) == (sdk.COMM_SUCCESS, 7), "read-only"
    assert packets.write1ByteTxRx(port, 1, 64, 1) == (sdk.COMM_SUCCESS, 0)
    assert bench.servos[0].powered
    assert packets.write1ByteTxRx(port, 1, 11, 1) == (sdk.COMM_SUCCESS, 7), "EEPROM while powered"


def test_dynamixel_sdk_moves_several_at_once(dynamixels):
    sdk, port, packets, bench = dynamixels
    goals = sdk.GroupSyncWrite(port, packets, 116, 4)
    for k in (1, 2, 3):
        packets.write4ByteTxRx(port, k, 112, 0)
        packets.write1ByteTxRx(port, k, 64, 1)
        goals.addParam(k, (2048 + 100 * k).to_bytes(4, "little"))
    assert goals.txPacket() == sdk.COMM_SUCCESS
    time.sleep(0.6)
    present = sdk.GroupSyncRead(port, packets, 126, 10)
    for k in (3, 1, 2):
        present.addParam(k)
    assert present.txRxPacket() == sdk.COMM_SUCCESS
    for k in (1, 2, 3):
        assert abs(present.getData(k, 132, 4) - (2048 + 100 * k)) <= 2


def test_a_bus_watchdog_stops_the_servo_until_it_is_cleared(dynamixels):
    sdk, port, packets, bench = dynamixels
    packets.write1ByteTxRx(port, 1, 64, 1)
    assert packets.write1ByteTxRx(port, 1, 98, 2) == (sdk.COMM_SUCCESS, 0)
    time.sleep(0.15)
    assert packets.read1ByteTxRx(port, 1, 98)[0] == 255
    assert packets.write4ByteTxRx(port, 1, 116, 2000) == (sdk.COMM_SUCCESS, 4)
    assert packets.write1ByteTxRx(port, 1, 98, 0) == (sdk.COMM_SUCCESS, 0)
    assert packets.write4ByteTxRx(port, 1, 116, 2000) == (sdk.COMM_SUCCESS, 0)


def test_feetech_sdk_pings_reads_and_writes(feetechs):
    sdk, port, packets, bench, scs = feetechs
    assert packets.ping(port, 2) == (1284 if scs else 777, sdk.COMM_SUCCESS, 0)
    assert packets.ping(port, 9)[1] == sdk.COMM_RX_TIMEOUT
    centre = 512 if scs else 2048
    assert packets.read2ByteTxRx(port, 1, 56) == (centre, sdk.COMM_SUCCESS, 0)
    assert packets.read1ByteTxRx(port, 1, 62) == (74, sdk.COMM_SUCCESS, 0)
    assert packets.write1ByteTxRx(port, 1, 40, 1) == (sdk.COMM_SUCCESS, 0)
    assert bench.servos[0].powered
    assert packets.write2ByteTxRx(port, 1, 42, centre - 100) == (sdk.COMM_SUCCESS, 0)
    time.sleep(0.6)
    position, _, _ = packets.read2ByteTxRx(port, 1, 56)
    assert abs(position - (centre - 100)) <= 2


def test_feetech_sdk_moves_several_at_once(feetechs):
    sdk, port, packets, bench, scs = feetechs
    centre = 512 if scs else 2048
    goals = sdk.GroupSyncWrite(port, packets, 42, 2)
    for k in (1, 2, 3):
        packets.write1ByteTxRx(port, k, 40, 1)
        goals.addParam(k, (centre + 30 * k).to_bytes(2, "big" if scs else "little"))
    goals.txPacket()
    time.sleep(0.6)
    present = sdk.GroupSyncRead(port, packets, 56, 2)
    for k in (3, 1, 2):
        present.addParam(k)
    result = present.txRxPacket()
    if scs:
        assert result != sdk.COMM_SUCCESS, "this series has no sync read"
        return
    assert result == sdk.COMM_SUCCESS
    for k in (1, 2, 3):
        assert abs(present.getData(k, 56, 2) - (centre + 30 * k)) <= 2


def test_error_bytes_tell_heat(capsys):
    dynamixel_sdk = pytest.importorskip("dynamixel_sdk")
    feetech_sdk = pytest.importorskip("scservo_sdk")
    for sdk, version, bus, bits in (
        (dynamixel_sdk, 2.0, "dynamixel", 128),
        (feetech_sdk, 0, "feetech", 4),
    ):
        with served(1, bus=bus, temperature_C=90) as bench:
            port = sdk.PortHandler(bench.port)
            assert port.setBaudRate(1_000_000)
            assert sdk.PacketHandler(version).ping(port, 1)[2] == bits
            port.closePort()
