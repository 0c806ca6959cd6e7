"""Packets whose bytes are known, from the maker's protocol worked out by hand."""

from sim2real.hardware.lx import BusCommand, Packet

GOLDEN = {
    "55 55 01 07 01 F4 01 14 00 ED": Packet(1, BusCommand.MOVE_TIME_WRITE, b"\xf4\x01\x14\x00"),
    "55 55 01 03 1C DF": Packet(1, BusCommand.POS_READ),
    "55 55 01 05 1C 00 02 DB": Packet(1, BusCommand.POS_READ, b"\x00\x02"),
    "55 55 01 05 1C F4 FF EA": Packet(1, BusCommand.POS_READ, b"\xf4\xff"),
    "55 55 01 03 1A E1": Packet(1, BusCommand.TEMP_READ),
    "55 55 01 04 1A 2D B3": Packet(1, BusCommand.TEMP_READ, b"\x2d"),
    "55 55 01 03 1B E0": Packet(1, BusCommand.VIN_READ),
    "55 55 01 05 1B E8 1C DA": Packet(1, BusCommand.VIN_READ, b"\xe8\x1c"),
    "55 55 01 04 11 F6 F3": Packet(1, BusCommand.ANGLE_OFFSET_ADJUST, b"\xf6"),
    "55 55 01 03 12 E9": Packet(1, BusCommand.ANGLE_OFFSET_WRITE),
    "55 55 01 03 13 E8": Packet(1, BusCommand.ANGLE_OFFSET_READ),
    "55 55 01 07 1D 00 00 00 00 DA": Packet(1, BusCommand.MOTOR_MODE_WRITE, bytes(4)),
    "55 55 01 07 1D 01 00 D4 FE 07": Packet(1, BusCommand.MOTOR_MODE_WRITE, b"\x01\x00\xd4\xfe"),
    "55 55 01 04 1F 01 DA": Packet(1, BusCommand.LOAD_WRITE, b"\x01"),
    "55 55 01 04 1F 00 DB": Packet(1, BusCommand.LOAD_WRITE, b"\x00"),
    "55 55 FE 03 0E F0": Packet(254, BusCommand.ID_READ),
    "55 55 FE 03 0B F3": Packet(254, BusCommand.MOVE_START),
    "55 55 01 03 0C EF": Packet(1, BusCommand.MOVE_STOP),
    "55 55 01 07 14 00 00 E8 03 F8": Packet(1, BusCommand.ANGLE_LIMIT_WRITE, b"\x00\x00\xe8\x03"),
    "55 55 01 03 24 D7": Packet(1, BusCommand.LED_ERROR_READ),
}
