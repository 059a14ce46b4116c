"""A finger of your own sensors on MicroPython: speaks pretouch's binary format over USB, with the board's own clock.

Copy it to the board as `finger.py`, and write a `main.py`, for two VL53L0X with any driver that you have:

    import finger
    from machine import I2C, Pin
    from vl53l0x import VL53L0X

    sensors = [VL53L0X(I2C(0)), VL53L0X(I2C(1))]

    def measure():  # for each module: tenths of a millimetre, or None, and its status code, 0 for a good range
        readings = [sensor.read() for sensor in sensors]
        return [(10 * mm, 0) if mm < 2000 else (None, 7) for mm in readings]

    finger.run(measure, modules=2, period_us=50_000)

The wire format is described in docs/reference/wire-formats.md.
"""

import os
import select
import struct
import sys
import time

import machine
import micropython

FIRMWARE = b"micropython finger 1.0"
RANGES, PING_REPLY, IDENTITY, PING, IDENTIFY = 0x01, 0x02, 0x03, 0x81, 0x83
NO_RANGE, NO_ANSWER = 0xFFFF, 255
LONGEST_REQUEST = 17
WATCHDOG_MS = 2000


def crc16(data):
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def encode(message):
    """The message's frame: its checksum behind it, no byte zero (COBS), and a zero that ends it."""
    blocks = (message + struct.pack("<H", crc16(message))).split(b"\0")
    return b"".join(bytes([len(block) + 1]) + block for block in blocks) + b"\0"


def decode(frame):
    """The message of a frame without its zero; None if it is damaged."""
    data = b""
    while frame:
        code = frame[0]
        if code == 0 or code > len(frame):
            return None
        data += frame[1:code] + b"\0"
        frame = frame[code:]
    message, crc = data[:-3], data[-3:-1]
    return message if len(crc) == 2 and crc == struct.pack("<H", crc16(message)) else None


class Finger:
    """The host's end is two byte streams, the board's USB."""

    def __init__(self, modules, period_us, source, sink):
        self.modules = modules
        self.period_us = period_us
        self.source = source
        self.sink = sink
        self.poll = select.poll()
        self.poll.register(source, select.POLLIN)
        self.boot = struct.unpack("<H", os.urandom(2))[0]  # another at every start
        self.sequence = 0
        self.micros = 0
        self.last = time.ticks_us()
        self.received = b""
        self.sink.write(b"\0")  # whatever the board said before ends here
        self.identify()

    def now(self):
        """Microseconds, modulo 2^32; the board's own ticks wrap earlier."""
        ticks = time.ticks_us()
        self.micros = (self.micros + time.ticks_diff(ticks, self.last)) & 0xFFFFFFFF
        self.last = ticks
        return self.micros

    def send(self, kind, sequence, micros, rest=b""):
        self.sink.write(encode(struct.pack("<BBHII", 1, kind, self.boot, sequence, micros) + rest))

    def identify(self):
        serial = machine.unique_id()[:8]
        serial += b"\0" * (8 - len(serial))
        self.send(IDENTITY, 0, 0, serial + struct.pack("<BI", self.modules, self.period_us) + FIRMWARE)

    def serve(self):
        """Answers what the host has asked."""
        while self.poll.poll(0):
            byte = self.source.read(1)
            if not byte:
                return
            if byte != b"\0":
                self.received = (self.received + byte)[: LONGEST_REQUEST + 1]
                continue
            message, self.received = decode(self.received), b""
            if message is None or len(message) != 12 or message[0] != 1:
                continue
            if message[1] == PING:
                self.send(PING_REPLY, struct.unpack("<I", message[4:8])[0], self.now())
            elif message[1] == IDENTIFY:
                self.identify()

    def measure(self, measure):
        """Sends one measurement, of the middle of the time that it took."""
        start = self.now()
        readings = measure()
        middle = (start + ((self.now() - start) & 0xFFFFFFFF) // 2) & 0xFFFFFFFF
        rest = struct.pack("<B", len(readings))
        for tenths, status in readings:
            rest += struct.pack("<HB", NO_RANGE if tenths is None else min(int(tenths), NO_RANGE - 1), status)
        self.send(RANGES, self.sequence, middle, rest)
        self.sequence = (self.sequence + 1) & 0xFFFFFFFF


def run(measure, modules, period_us):
    """Measures once a period, for ever. A `measure` that raises OSError tells that no module answers."""
    micropython.kbd_intr(-1)  # a byte 3 from the host is no Ctrl-C
    finger = Finger(modules, period_us, sys.stdin.buffer, sys.stdout.buffer)
    watchdog = machine.WDT(timeout=WATCHDOG_MS)

    def guarded():
        try:
            return measure()
        except OSError:
            return [(None, NO_ANSWER)] * modules

    due = time.ticks_us()
    while True:
        watchdog.feed()
        finger.serve()
        if time.ticks_diff(time.ticks_us(), due) >= 0:
            finger.measure(guarded)
            due = time.ticks_add(due, period_us)
            if time.ticks_diff(time.ticks_us(), due) > 0:  # held up for more than a period
                due = time.ticks_us()
