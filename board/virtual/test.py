#!/usr/bin/env python3
"""The virtual-board test: kernel camera in, kernel display out, on an emulated ARM board.

usage: test.py [--host BINARY] [--dir DIR] [--frames N] [--skip-build] [--only loop|clock|recover]

1. loop   A clip with a moving marker, made by the program itself, is fed into the kernel's vivid driver.
          `vernissage run` on the board takes it from /dev/video0, draws it and shows it on /dev/dri/card0. Checked:
          frames in order, marker tracked, every shown frame's scan-out buffer identical with a replay of its trace
          on this machine, and pictures taken from the emulated screen identical with the replay's files.
2. clock  The board's clock counts instructions: the program's own times become million ARM instructions, of the
          whole frame's stages and of every style alone. Checked: no style costs more than its bound, and every
          style's picture is the one this machine draws, byte for byte.

3. recover  Only when asked for (`--only recover`): the camera is disconnected, unbound and made to fail at random
          times. Checked: the program goes on, is back within 300 ms, counts every fault, and leaks nothing.

Needs what install.sh installs and a release build of the program for this machine (made if missing). Everything
is kept in DIR (default target/virtual-board): console logs, the trace, screen pictures, replayed frames.
Prints PASS or FAIL lines; exit code 1 when anything failed.
"""

import argparse
import functools
import json
import os
import re
import shutil
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

VISOR = """
threads = 2
[camera]
source = "v4l2"
device = "/dev/video0"
width = 640
height = 480
[[model]]
file = "teapot"
marker = { family = "tag36h11", id = 7, side_mm = 80 }
[style]
name = "cartoon"
[display]
sink = "kms"
scale = "one-to-one"
"""

LOOP = """
feed /host/clip.yuyv 640 480 2 > /tmp/feed.log 2>&1 &
for i in $(seq 200); do grep -q feeding /tmp/feed.log && break; sleep .1; done
cat /tmp/feed.log
echo BOARD: run
vernissage run --config /host/visor.toml --frames {frames} --json --trace /tmp/trace.bin > /host/run.json 2> /host/run.err &
while grep VmHWM /proc/$!/status > /tmp/now 2> /dev/null; do mv /tmp/now /host/memory; sleep .5; done
wait $!
echo BOARD: ran $?
cp /tmp/trace.bin /host/trace.bin
"""

CLOCK = """
echo BOARD: run
vernissage demo --frames 4 --threads 1 --out /tmp/demo > /host/clock.txt 2> /host/clock.err || echo BOARD: ran 1
for style in {styles}; do
  vernissage stylize --style $style --repeat 3 --json --threads 1 /host/frame.png >> /host/clock.jsonl 2>> /host/clock.err \\
    || echo BOARD: ran 1
  vernissage stylize --style $style --threads 1 /host/frame.png --out /host/$style.png 2>> /host/clock.err \\
    || echo BOARD: ran 1
done
echo BOARD: ran 0
"""

# how often each trouble comes: a twentieth of what a full soak does
TROUBLES = {"disconnect": 10, "unbind": 3, "V4L2_BUF_FLAG_ERROR": 3, "VIDIOC_STREAMON Error": 3, "Fatal Streaming Error": 3}

RECOVER = """
cat > /tmp/visor.toml <<END
threads = 2
[camera]
source = "v4l2"
device = "/dev/video0"
width = 640
height = 480
[style]
name = "plain"
[display]
sink = "kms"
END
facts() {{
  echo "BOARD: $1 $(ls /proc/$pid/fd | wc -l) $(awk '/VmRSS/{{print $2}}' /proc/$pid/status) $(awk '{{print $14+$15}}' /proc/$pid/stat) $(cut -d' ' -f1 /proc/uptime)"
}}
echo BOARD: run
vernissage run --wait --config /tmp/visor.toml --status /tmp/status.json --json > /host/recover.json 2> /host/recover.err &
pid=$!
sleep 6
facts before
for i in $(seq {disconnect}); do ctl /dev/video0 Disconnect 1; sleep 2; done
for what in "V4L2_BUF_FLAG_ERROR" "VIDIOC_STREAMON Error" "Fatal Streaming Error"; do
  for i in $(seq {injections}); do ctl /dev/video0 "Inject $what" 1; sleep 2; done
done
for i in $(seq {unbind}); do
  echo vivid.0 > /sys/bus/platform/drivers/vivid/unbind
  sleep 1; facts lost; sleep 4; facts waits
  echo vivid.0 > /sys/bus/platform/drivers/vivid/bind
  sleep 3
done
ctl /dev/video0 "Percentage of Dropped Buffers" 100
sleep 5
ctl /dev/video0 "Percentage of Dropped Buffers" 0
sleep 3
facts after
cp /tmp/status.json /host/recover-status.json
kill -TERM $pid
wait $pid
echo BOARD: ran $?
"""

# million ARM instructions that a style may take for a 640x480 picture, bytes to bytes
BUDGET = {"cartoon": 70, "bilateral-cartoon": 40, "sketch-like": 40, "watercolor": 40, "illustrative": 40,
          "pointillism": 40, "sketchy": 40}

failures = 0


def check(passed, what):
    """Prints one verdict."""
    global failures
    failures += not passed
    print(("PASS " if passed else "FAIL ") + what, flush=True)
    return passed


def note(text):
    print("     " + text, flush=True)


class Board:
    """A booted board: its console lines, its monitor. Always ended by `close`."""

    def __init__(self, folder, name, options=()):
        self.folder = folder
        self.lines = []
        self.log = open(folder / f"{name}.log", "w")
        self.process = subprocess.Popen(
            ["bash", HERE / "boot.sh", folder, *options],
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


def loop(host, folder, frames):
    """Boot 1: camera to display, and the replay."""
    if not make_clip(host, folder, 60):
        return
    for name in ("trace.bin", "run.json", "run.err"):
        (folder / "host" / name).unlink(missing_ok=True)
    for name in ("screen", "replay"):
        shutil.rmtree(folder / name, ignore_errors=True)
    (folder / "screen").mkdir()
    (folder / "host" / "visor.toml").write_text(VISOR)
    (folder / "host" / "run.sh").write_text(LOOP.format(frames=frames))

    board = Board(folder, "loop")
    dumps = []
    try:
        booted = time.monotonic()
        if not check(board.wait_for("run", 90), "board: boots and its camera is fed"):
            return
        note(f"{time.monotonic() - booted:.1f} s to the program's start")
        end = time.monotonic() + 240
        while board.said("ran") is None and time.monotonic() < end and board.process.poll() is None:
            path = folder / "screen" / f"{len(dumps):03}.ppm"
            board.command(f"screendump {path}")
            dumps.append(path)
            time.sleep(1.5)
        finished = board.wait_for("ran", 1)
    except OSError as error:
        finished = check(False, f"board: monitor: {error}")
    finally:
        by_itself = board.close(60)
    check(by_itself, "board: powers off by itself")
    if not check(finished and board.said("ran") == "0", f"run: ends well (exit {board.said('ran')})"):
        for line in (folder / "host" / "run.err").read_text().splitlines()[-10:]:
            note(line)
        return

    figures = json.loads((folder / "host" / "run.json").read_text())
    note(json.dumps(figures))
    shown, tracked = figures["shown"], figures["tracked"]
    check(shown == frames, f"run: {shown} of {frames} frames shown")
    check(figures["out_of_order"] == 0, f"run: {figures['out_of_order']} frames out of order"
          f" ({figures['missing']} missing in the camera's sequence, {figures['replaced']} replaced by newer ones)")
    check(tracked >= 0.95 * frames, f"run: marker tracked in {tracked} of {frames} frames")
    memory = int((folder / "host" / "memory").read_text().split()[1]) / 1024
    check(memory <= 64, f"run: {memory:.0f} MB of memory at most")
    # the trace's first record tells when its picture was shown, on the clock that starts with the kernel
    first = int.from_bytes((folder / "host" / "trace.bin").read_bytes()[28:36], "little") / 1e9
    note(f"first picture {first:.1f} s after the kernel's start (the emulation takes as long as this machine is busy)")

    said = run([host, "render", "--config", folder / "host" / "visor.toml",
                "--trace", folder / "host" / "trace.bin", "--out", folder / "replay"], 120)
    same = re.search(r"replay: (\d+) of (\d+) shown frames identical", said or "")
    check(bool(same) and int(same[1]) == int(same[2]) == frames,
          f"replay: {same[0] if same else 'not done'}")
    if said is not None:
        compare_screen(folder, dumps)


def compare_screen(folder, dumps):
    """Every picture taken from the screen while frames were shown is one of the replay's, in order."""
    files = sorted((folder / "replay").glob("*.png"))
    # undoing PNG filters is slow here: few rows name the candidates, which are then compared whole
    some = 12
    starts = [read_png(path, some)[2] for path in files]
    whole = functools.cache(read_png)
    order = []
    for screen in filter(None, (read_ppm(path) for path in dumps if path.exists())):
        start = screen[2][:some * WIDTH * 3]
        matches = [i for i, known in enumerate(starts) if known == start and whole(files[i]) == screen]
        # the clip comes round again: of equal pictures the first that is not before the last one seen
        last = next((index for index in reversed(order) if index is not None), 0)
        order.append(min(matches, key=lambda index: (index < last, index), default=None))
    # before the first frame and after the last the screen is the console's or black
    while order and order[0] is None:
        order.pop(0)
    while order and order[-1] is None:
        order.pop()
    note(f"screen pictures show replayed frames {order}")
    known = [index for index in order if index is not None]
    check(len(known) >= 3 and len(known) == len(order) and known == sorted(known),
          f"screen: {len(known)} of {len(order)} pictures taken while running are replayed frames, in order")


def clock(host, folder):
    """Boot 2: one instruction is one nanosecond, so a millisecond is a million instructions."""
    for name in ("clock.txt", "clock.jsonl", "clock.err", *(f"{style}.png" for style in BUDGET)):
        (folder / "host" / name).unlink(missing_ok=True)
    shutil.rmtree(folder / "frame", ignore_errors=True)
    (folder / "clip.toml").write_text(CLIP.format(frames=1))
    if run([host, "render", "--config", folder / "clip.toml", "--out", folder / "frame"], 120) is None:
        check(False, "clock: a picture made by the program")
        return
    shutil.copy(next((folder / "frame").glob("*.png")), folder / "host" / "frame.png")
    (folder / "host" / "run.sh").write_text(CLOCK.format(styles=" ".join(BUDGET)))
    board = Board(folder, "clock", ["-smp", "1", "-icount", "shift=0,sleep=off"])
    try:
        board.wait_for("ran", 480)
    finally:
        board.close(20)
    if not check(board.said("ran") == "0", f"clock: measured (exit {board.said('ran')})"):
        for line in (folder / "host" / "clock.err").read_text().splitlines()[-10:]:
            note(line)
        return
    note("ms on the board's clock = million ARM instructions:")
    for line in (folder / "host" / "clock.txt").read_text().splitlines():
        note(line)
    costs = {line["style"]: min(line["ms"])
             for line in map(json.loads, (folder / "host" / "clock.jsonl").read_text().splitlines())}
    same = []
    for style in BUDGET:
        here = folder / "frame" / f"{style}.png"
        drawn = run([host, "stylize", "--style", style, folder / "host" / "frame.png", "--out", here], 60)
        if drawn is not None and here.read_bytes() == (folder / "host" / f"{style}.png").read_bytes():
            same.append(style)
    check(len(same) == len(BUDGET), f"clock: pictures identical on both machines: {', '.join(same)}")
    for style, budget in BUDGET.items():
        cost = costs.get(style, float("inf"))
        check(cost <= budget, f"clock: {style} {cost:.1f} million instructions a frame, at most {budget}")


def recover(folder):
    """Boot 3: a camera that falters."""
    for name in ("recover.json", "recover.err", "recover-status.json"):
        (folder / "host" / name).unlink(missing_ok=True)
    (folder / "host" / "run.sh").write_text(RECOVER.format(injections=TROUBLES["V4L2_BUF_FLAG_ERROR"], **{
        name: TROUBLES[name] for name in ("disconnect", "unbind")}))
    board = Board(folder, "recover")
    try:
        board.wait_for("ran", 400)
    finally:
        board.close(30)
    log = folder / "host" / "recover.err"
    if not check(board.said("ran") == "0", f"recover: the program goes on and ends well (exit {board.said('ran')})"):
        for line in (log.read_text() if log.exists() else "").splitlines()[-10:]:
            note(line)
        return
    facts = {word: [tuple(map(float, line.split()[2:])) for line in board.lines if line.startswith(f"BOARD: {word} ")]
             for word in ("before", "lost", "waits", "after")}
    (before,), (after,) = facts["before"], facts["after"]
    check(after[0] == before[0], f"recover: {after[0]:.0f} open files, before {before[0]:.0f}")
    check(after[1] <= before[1] + 2048, f"recover: {after[1]:.0f} KiB resident, before {before[1]:.0f}")
    busy = [(b[2] - a[2]) / 100 / (b[3] - a[3]) for a, b in zip(facts["lost"], facts["waits"])]
    check(bool(busy) and max(busy) < 0.05, f"recover: {100 * max(busy, default=1):.1f} % of a core while the camera is lost")
    status = json.loads((folder / "host" / "recover-status.json").read_text())
    faults = {fault["code"]: fault for fault in status["faults"]}
    note(json.dumps(status["faults"]) + " " + json.dumps(status["camera"]))
    check(status["state"] == "run" and not any(fault["now"] for fault in faults.values()), "recover: all is well at the end")
    lost = faults.get("C1", {"count": 0})["count"]
    check(lost >= TROUBLES["disconnect"] + TROUBLES["unbind"], f"recover: camera lost {lost} times")
    check(faults.get("C2", {"count": 0})["count"] >= 1, "recover: silence counted")
    check(status["camera"]["damaged"] >= TROUBLES["V4L2_BUF_FLAG_ERROR"], f"recover: {status['camera']['damaged']} damaged pictures counted")
    back = [float(value) / {"s": 0.001, "ms": 1, "µs": 1000}[unit] for value, unit in
            re.findall(r"pictures again after ([0-9.]+)(s|ms|µs)", log.read_text())]
    # unplugged for five seconds, and silent for five: those begin when the device left; the others were back at once
    quick = sorted(value for value in back if value < 4000)
    check(len(quick) >= TROUBLES["disconnect"] and quick[-1] <= 300, f"recover: pictures again after {quick} ms")


def main():
    arguments = argparse.ArgumentParser(description="The virtual-board test.")
    arguments.add_argument("--host", type=Path, help="the program for this machine, target/release/vernissage")
    arguments.add_argument("--dir", type=Path, default=ROOT / "target" / "virtual-board")
    arguments.add_argument("--frames", type=int, default=60)
    arguments.add_argument("--skip-build", action="store_true", help="use the board as it is in DIR")
    arguments.add_argument("--only", choices=["loop", "clock", "recover"])
    chosen = arguments.parse_args()
    folder = chosen.dir.resolve()
    (folder / "host").mkdir(parents=True, exist_ok=True)
    began = time.monotonic()

    if not chosen.skip_build:
        built = run(["bash", HERE / "build.sh", folder], 1800)
        if not check(built is not None, f"build: binary and board in {folder}"):
            return 1
    host = chosen.host or ROOT / "target" / "release" / "vernissage"
    if chosen.host is None and run(["cargo", "build", "--release", "--quiet"], 1800, cwd=ROOT) is None:
        return 1
    began = time.monotonic()
    if chosen.only == "recover":
        recover(folder)
    if chosen.only in (None, "loop"):
        loop(host.resolve(), folder, chosen.frames)
    if chosen.only in (None, "clock"):
        clock(host.resolve(), folder)
    note(f"{time.monotonic() - began:.0f} s, logs and pictures in {folder}")
    print("virtual board: " + (f"{failures} checks FAILED" if failures else "all checks passed"))
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
