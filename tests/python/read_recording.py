"""Reads a recording in plain Python: MCAP by the package `mcap`, our frames by docs/PROTOCOL.md.

    python read_recording.py RECORDING [SECONDS]

Prints one JSON object: how many samples it read, how long the processor took, and some of what it read. It stops after SECONDS of
samples. It is what `cargo xtask bench-files` compares `inerter export` with, and an example for whoever writes a reader.
"""

import json
import sys
import time
import zlib
from array import array

from mcap.reader import make_reader

SAMPLES = 1
WRAP = 1 << 32


def unstuff(frame):
    """COBS: each code byte says how many bytes follow up to the next zero."""
    out = bytearray()
    place = 0
    while place < len(frame):
        code = frame[place]
        out += frame[place + 1 : place + code]
        place += code
        if code < 255 and place < len(frame):
            out.append(0)
    return out


def payload_of(frame):
    """The payload of a frame whose checksum agrees, else None."""
    body = unstuff(frame)
    if len(body) < 7 or zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
        return None
    return body[:-6]


def numbers(data):
    """Zigzag varints."""
    value = shift = 0
    for byte in data:
        value |= (byte & 127) << shift
        if byte & 128:
            shift += 7
        else:
            yield (value >> 1) ^ -(value & 1)
            value = shift = 0


def signed(value):
    """The number that 32 bits stand for."""
    return (value + WRAP // 2) % WRAP - WRAP // 2


class Reader:
    """Columns in SI, as `inerter export` writes them."""

    def __init__(self, settings):
        self.period_s = 1 / settings["sample_rate_hz"]
        self.metres = settings["metres_per_count"] / settings["oversampling"]
        self.newtons = settings["newtons_per_code"]
        self.zero = settings["force_zero_code"]
        self.elapsed = self.last_index = self.last_count = None
        self.count = 0
        self.t_s, self.position_m, self.force_n = array("d"), array("d"), array("d")

    def batch(self, payload):
        # Record number, count and length are below 128 but for the length, which may take two bytes.
        data = payload[3:] if payload[2] < 128 else payload[4:]
        found = numbers(data)
        index, count, force, terminal = -1, 0, 0, 0
        for step, moved, pushed, displaced in zip(found, found, found, found):
            index = (index + 1 + step) % WRAP
            count = signed(count + moved)
            force = signed(force + pushed)
            terminal = signed(terminal + displaced)
            self.sample(index, count, force)

    def sample(self, index, count, force):
        if self.elapsed is None:
            self.elapsed, self.count = 0, count
        else:
            step = (index - self.last_index) % WRAP
            self.elapsed += step if step < WRAP // 2 else 1
            self.count += signed(count - self.last_count)
        self.last_index, self.last_count = index, count
        self.t_s.append(self.elapsed * self.period_s)
        self.position_m.append(self.count * self.metres)
        self.force_n.append((force - self.zero) * self.newtons)


def settings_of(reader):
    for metadata in reader.iter_metadata():
        if metadata.name == "inerter.settings":
            return {name: float(text) for name, text in metadata.metadata.items()}
    raise SystemExit("no settings in this recording")


def main(path, seconds):
    begin = time.process_time()
    with open(path, "rb") as file:
        reader = make_reader(file)
        run = Reader(settings_of(reader))
        for _, _, message in reader.iter_messages(topics=["raw"], log_time_order=False):
            payload = payload_of(message.data[:-1])
            if payload and payload[0] == SAMPLES:
                run.batch(payload)
                if run.t_s[-1] >= seconds:
                    break
    took = time.process_time() - begin
    last = {"t_s": run.t_s[-1], "position_m": run.position_m[-1], "force_n": run.force_n[-1]}
    print(json.dumps({"samples": len(run.t_s), "seconds": took, "last": last, "force_sum_n": sum(run.force_n)}))


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]) if len(sys.argv) > 2 else float("inf"))
