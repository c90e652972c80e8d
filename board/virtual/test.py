#!/usr/bin/env python3
"""The virtual-board test: kernel camera in, kernel display out, on an emulated ARM board.

usage: test.py [--host BINARY] [--dir DIR] [--frames N] [--skip-build] [--only loop|clock|recover|stalls|plugs|cuts]
       [--soak]

1. loop   A clip with a moving marker, made by the program itself, is fed into the kernel's vivid driver.
          `vernissage run` on the board takes it from /dev/video0, draws it and shows it on /dev/dri/card0. Checked:
          frames in order, marker tracked, every shown frame's scan-out buffer identical with a replay of its trace
          on this machine, and pictures taken from the emulated screen identical with the replay's files.
2. clock  The board's clock counts instructions: the program's own times become million ARM instructions, of the
          whole frame's stages, of finding and following a marker (markers.py), and of every style alone. Checked:
          none costs more than its bound, and every style's picture is the one this machine draws, byte for byte.
3. recover  The camera is disconnected, unbound and made to fail, in random order: recover.py. With --soak as often as
          a release wants it, else a twentieth. Checked besides: the first picture comes soon after the kernel's start.
4. stalls  The program stands still for a tenth of a second, once a second: stalls.py.
5. plugs  The screen's cable, another program on the screen, the button board's USB plug: plugs.py.
6. cuts   The power goes while settings are written: cuts.py.

Checked besides: the binary is at most 8 MB.

Needs what install.sh installs and a release build of the program for this machine (made if missing). Everything
is kept in DIR (default target/virtual-board): console logs, the trace, screen pictures, replayed frames.
Prints PASS or FAIL lines; exit code 1 when anything failed.
"""

import argparse
import functools
import json
import re
import shutil
import sys
import time
from pathlib import Path

sys.dont_write_bytecode = True  # nothing is left beside the sources
import cuts
import markers
import plugs
import recover
import stalls
from board import CLIP, HERE, ROOT, WIDTH, Board, check, make_clip, note, read_png, read_ppm, run, verdict

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
{markers}
echo BOARD: ran 0
"""

BINARY_MB = 8

# million ARM instructions that a style may take for a 640x480 picture, bytes to bytes
BUDGET = {"cartoon": 70, "bilateral-cartoon": 40, "sketch-like": 40, "watercolor": 40, "illustrative": 40,
          "pointillism": 40, "sketchy": 40}

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
    if not markers.make(host, folder):
        return
    (folder / "host" / "run.sh").write_text(CLOCK.format(styles=" ".join(BUDGET), markers=markers.SCRIPT))
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
    markers.judge(folder)
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


def main():
    arguments = argparse.ArgumentParser(description="The virtual-board test.")
    arguments.add_argument("--host", type=Path, help="the program for this machine, target/release/vernissage")
    arguments.add_argument("--dir", type=Path, default=ROOT / "target" / "virtual-board")
    arguments.add_argument("--frames", type=int, default=60)
    arguments.add_argument("--skip-build", action="store_true", help="use the board as it is in DIR")
    arguments.add_argument("--soak", action="store_true", help="every trouble as often as a release wants it")
    arguments.add_argument("--only", choices=["loop", "clock", "recover", "stalls", "plugs", "cuts"])
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
    size = (folder / "vernissage").stat().st_size / 1e6
    check(size <= BINARY_MB, f"binary: {size:.2f} MB, static and stripped, at most {BINARY_MB}")
    began = time.monotonic()
    if chosen.only in (None, "loop"):
        loop(host.resolve(), folder, chosen.frames)
    if chosen.only in (None, "clock"):
        clock(host.resolve(), folder)
    if chosen.only in (None, "recover"):
        recover.recover(folder, chosen.soak)
    if chosen.only in (None, "stalls"):
        stalls.stalls(folder, chosen.soak)
    if chosen.only in (None, "plugs"):
        plugs.plugs(host.resolve(), folder, chosen.soak)
    if chosen.only in (None, "cuts"):
        cuts.cuts(folder, chosen.soak)
    note(f"{time.monotonic() - began:.0f} s, logs and pictures in {folder}")
    return verdict("virtual board")


if __name__ == "__main__":
    sys.exit(main())
