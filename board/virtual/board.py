"""The emulated board as its tests use it: boot it, hear its console, ask its monitor, judge.

For test.py, recover.py, plugs.py and service.py. `check` prints PASS or FAIL lines and counts the failures.
"""

import os
import re
import socket
import subprocess
import sys
import threading
import time
import zlib
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
WIDTH, HEIGHT = 640, 480

# one seed and one path for the marker, the same on every machine
CLIP = """
[camera]
source = "synthetic"
width = 640
height = 480
[camera.synthetic]
frames = {frames}
[style]
name = "plain"
"""

failures = 0


def check(passed, what):
    """Prints one verdict."""
    global failures
    failures += not passed
    print(("PASS " if passed else "FAIL ") + what, flush=True)
    return passed


def note(text):
    print("     " + text, flush=True)


def verdict(name):
    """The last line of a test; its exit code."""
    print(f"{name}: " + (f"{failures} checks FAILED" if failures else "all checks passed"))
    return 1 if failures else 0


# an instruction takes two nanoseconds of the board's clock: what is measured on it repeats on a busy machine
STEADY_CLOCK = ["-smp", "1", "-icount", "shift=1,sleep=off"]
# separate page tables for every call into the kernel cost the emulation much and show nothing here
PLAIN_KERNEL = ["-append", "console=ttyAMA0 panic=-1 quiet kpti=off mitigations=off"]


class Board:
    """A booted board: its console lines, its monitor. Always ended by `close`."""

    def __init__(self, folder, name, options=(), boot=HERE / "boot.sh"):
        self.folder = folder
        self.lines = []
        self.log = open(folder / f"{name}.log", "w")
        self.process = subprocess.Popen(
            ["bash", boot, folder, *options],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        self.reader = threading.Thread(target=self.read, daemon=True)
        self.reader.start()
        self.monitor = None

    def read(self):
        for line in self.process.stdout:
            line = line.decode(errors="replace").rstrip()
            self.log.write(line + "\n")
            self.log.flush()
            self.lines.append(line)

    def said(self, word):
        """The first console line that begins with `BOARD: word`, without that."""
        start = f"BOARD: {word}"
        return next((line[len(start):].strip() for line in self.lines if line.startswith(start)), None)

    def wait_for(self, word, seconds):
        """Whether the board says it in time."""
        end = time.monotonic() + seconds
        while self.said(word) is None and time.monotonic() < end and self.process.poll() is None:
            time.sleep(0.05)
        self.reader.join(0 if self.process.poll() is None else 5)
        return self.said(word) is not None

    def command(self, text, seconds=10):
        """One monitor command; returns when the monitor asks for the next."""
        if self.monitor is None:
            self.monitor = socket.socket(socket.AF_UNIX)
            self.monitor.settimeout(seconds)
            self.monitor.connect(os.path.relpath(self.folder / "monitor.sock"))
            self.prompt()
        self.monitor.sendall(text.encode() + b"\n")
        self.prompt()

    def prompt(self):
        heard = b""
        while not heard.endswith(b"(qemu) "):
            part = self.monitor.recv(4096)
            if not part:
                raise OSError("the monitor closed")
            heard += part

    def close(self, seconds):
        """Waits for the board to power off, or ends it. Whether it went by itself."""
        try:
            self.process.wait(seconds)
            return True
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            return False
        finally:
            self.reader.join(5)
            self.log.close()


def run(command, seconds, **options):
    """Runs a command on this machine; its output, or None after telling what went wrong."""
    try:
        done = subprocess.run([str(part) for part in command], timeout=seconds, text=True,
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT, **options)
    except subprocess.TimeoutExpired:
        note(f"{command[0]}: not done within {seconds} s")
        return None
    if done.returncode != 0:
        note(f"{' '.join(map(str, command))}: exit {done.returncode}")
        for line in done.stdout.splitlines()[-8:]:
            note("  " + line)
        return None
    return done.stdout


def y4m_to_yuyv(source, target):
    """C444 full range -> YUYV limited range, as webcams send it; the number of frames."""
    to_luma = bytes(int(16 + 219 * v / 255 + 0.5) for v in range(256))
    to_chroma = bytes(int(128 + 224 * (v - 128) / 255 + 0.5) for v in range(256))
    area = WIDTH * HEIGHT
    count = 0
    with open(source, "rb") as clip, open(target, "wb") as raw:
        header = clip.readline()
        assert b"C444" in header and f" W{WIDTH} H{HEIGHT} ".encode() in header, header
        while clip.readline().startswith(b"FRAME"):
            luma, blue, red = (clip.read(area) for _ in range(3))
            frame = bytearray(2 * area)
            frame[0::2] = luma.translate(to_luma)
            frame[1::4] = blue[0::2].translate(to_chroma)
            frame[3::4] = red[0::2].translate(to_chroma)
            raw.write(frame)
            count += 1
    return count


def read_ppm(path):
    """Pixels of a binary PPM, or None while it is not whole."""
    data = path.read_bytes()
    head = re.match(rb"P6\s+(\d+)\s+(\d+)\s+255\s", data)
    if not head or len(data) - head.end() != int(head[1]) * int(head[2]) * 3:
        return None
    return int(head[1]), int(head[2]), data[head.end():]


def read_png(path, rows=None):
    """Pixels of an 8-bit RGB PNG that is not interlaced; of its first rows where only some are wanted."""
    data = path.read_bytes()
    at, packed, width, height = 8, b"", 0, 0
    while at < len(data):
        length, kind = int.from_bytes(data[at:at + 4], "big"), data[at + 4:at + 8]
        body = data[at + 8:at + 8 + length]
        if kind == b"IHDR":
            width, height = (int.from_bytes(body[i:i + 4], "big") for i in (0, 4))
            assert body[8:] == b"\x08\x02\x00\x00\x00", "not an 8-bit RGB PNG"
        packed += body if kind == b"IDAT" else b""
        at += 12 + length
    lines, pitch = zlib.decompress(packed), width * 3
    above, pixels = bytearray(pitch), bytearray()
    for y in range(rows or height):
        start = y * (pitch + 1)
        line = bytearray(lines[start + 1:start + 1 + pitch])
        unfilter(lines[start], line, above)
        pixels += line
        above = line
    return width, height, bytes(pixels)


def unfilter(kind, line, above):
    """Undoes one PNG line filter in place (PNG specification, section 9)."""
    for i in range(len(line)):
        left = line[i - 3] if i >= 3 else 0
        if kind == 1:
            line[i] = (line[i] + left) & 255
        elif kind == 2:
            line[i] = (line[i] + above[i]) & 255
        elif kind == 3:
            line[i] = (line[i] + (left + above[i]) // 2) & 255
        elif kind == 4:
            corner = above[i - 3] if i >= 3 else 0
            guess = left + above[i] - corner
            near = min((left, above[i], corner), key=lambda v: abs(guess - v))
            line[i] = (line[i] + near) & 255


def make_clip(host, folder, frames):
    """The clip that the board's camera will see, drawn by the program's own synthetic camera."""
    (folder / "clip.toml").write_text(CLIP.format(frames=frames))
    clip = folder / "clip.y4m"
    if run([host, "render", "--config", folder / "clip.toml", "--out", clip], 120) is None:
        return check(False, "clip: made by the program")
    count = y4m_to_yuyv(clip, folder / "host" / "clip.yuyv")
    clip.unlink()
    return check(count == frames, f"clip: {count} frames of a moving marker")


class Buttons:
    """A button board: the simulator of the program's own tests behind an emulated USB serial adapter."""

    def __init__(self, folder):
        self.link = folder / "buttons"
        self.link.unlink(missing_ok=True)
        self.log = open(folder / "buttons.log", "w+")
        self.process = subprocess.Popen([sys.executable, ROOT / "tests" / "board_simulator.py", self.link],
                                        stdin=subprocess.PIPE, stdout=self.log)
        end = time.monotonic() + 10
        while not self.link.is_symlink() and time.monotonic() < end:
            time.sleep(0.02)

    def heard(self, what):
        """How often the visor said a line with this in it."""
        return sum(" rx " in line and what in line for line in Path(self.log.name).read_text().splitlines())

    def wait_for(self, what, count, seconds):
        end = time.monotonic() + seconds
        while self.heard(what) < count and time.monotonic() < end:
            time.sleep(0.1)
        return self.heard(what) >= count

    def press(self):
        for command in (b"down 1\n", b"up 1\n"):
            self.process.stdin.write(command)
            self.process.stdin.flush()
            time.sleep(0.1)

    def close(self):
        self.process.stdin.close()
        self.process.wait(10)
        self.log.close()
        self.link.unlink(missing_ok=True)
