"""Power cuts while settings are written, on the emulated board with a disk.

The settings file lies on an ext4 of the disk and is written in place again and again, as a hasty hand would; the visor
takes each and keeps it. The power goes at random moments (the emulator is killed: what the kernel had not written is
gone, and leaves an empty file as often as not). Checked at every next start: pictures are shown, drawn with the settings
before the cut or with those that were being written.
"""

import json
import random
import time
from board import PLAIN_KERNEL, Board, check, note, run

STYLES = ["plain", "illustrative", "sketch-like", "cartoon", "watercolor"]
# how often: in a full run, and by default
CUTS = (50, 3)

VISOR = """
# number {number}
threads = 1
[camera]
source = "synthetic"
width = 160
height = 120
fps = 10
[display]
sink = "null"
{padding}
[style]
name = "{style}"
"""

SCRIPT = r"""
for module in $(cat /mods/disk); do insmod /mods/$module; done
mkdir -p /disk
mount -t ext4 /dev/vda /disk
mkdir -p /disk/state
[ -e /disk/visor.toml ] || cp /host/settings.0 /disk/visor.toml
number=$(cat /host/number)
STATE_DIRECTORY=/disk/state vernissage run --wait --config /disk/visor.toml --status /tmp/status.json > /tmp/out 2> /tmp/err &
pid=$!
for i in $(seq 100); do grep -q '"shown": [1-9]' /tmp/status.json 2> /dev/null && break; sleep .1; done
echo BOARD: found $(grep '"style": "' /tmp/status.json | head -1 | tr -d '",' | cut -d: -f2) \
  $(grep '"refused"' /tmp/status.json | grep -vc null) $(cat /tmp/err | grep -c 'settings as they were last')
while kill -0 $pid; do
  number=$((number + 1))
  text=/host/settings.$number
  echo BOARD: begins-$number
  : > /disk/visor.toml; sleep .$((RANDOM % 3)); cat $text > /disk/visor.toml
  kill -HUP $pid
  for i in $(seq 200); do grep -qs "^# number $number\$" /disk/state/settings.* && break; sleep .02; done
  echo BOARD: kept-$number
  sleep .3
done
echo BOARD: gone
tail -3 /tmp/err
"""


def cuts(folder, full):
    """Cuts the power so often."""
    times = CUTS[0 if full else 1]
    host = folder / "host"
    disk = folder / "cuts.ext4"
    disk.unlink(missing_ok=True)
    if run(["/sbin/mke2fs", "-q", "-t", "ext4", disk, "32M"], 60) is None:
        return check(False, "cuts: a disk")
    style = lambda number: STYLES[number % len(STYLES)]
    padding = "\n".join(f"# {'x' * 90}" for _ in range(30))
    for number in range(1 + 40 * (times + 1)):
        text = VISOR.format(number=number, style=style(number), padding=padding)
        (host / f"settings.{number}").write_text(text)
    (host / "run.sh").write_text(SCRIPT)
    chance = random.Random(1971)
    number, force = 0, style(0)
    good, refused, kept, between = 0, 0, 0, 0
    for cut in range(times + 1):
        (host / "number").write_text(str(number))
        board = Board(folder, "cuts", ["-drive", f"file={disk.name},if=virtio,format=raw", *PLAIN_KERNEL])
        try:
            if not board.wait_for("found", 120):
                note(f"cut {cut}: no picture after it")
                break
            found, told, last = (board.said("found").split() + ["", "0", "0"])[:3]
            # what was begun last, or what was in force before the cut
            fits = found in (style(number), force)
            good += fits
            refused += told != "0"
            kept += last != "0"
            if not fits:
                note(f"cut {cut}: found {found}; {force} was in force, {style(number)} being written")
            force = found
            if cut == times:
                break
            end = time.monotonic() + 20
            while board.said(f"begins-{number + 1}") is None and time.monotonic() < end:
                time.sleep(0.01)
            time.sleep(chance.uniform(0, 2.5))
        finally:
            board.close(0)
        begun = [int(line.split("-")[1]) for line in board.lines if line.startswith("BOARD: begins-")]
        done = [int(line.split("-")[1]) for line in board.lines if line.startswith("BOARD: kept-")]
        number = max(begun, default=number)
        force = style(max(done)) if done else force
        between += number not in done
    for old in [*host.glob("settings.*"), host / "number"]:
        old.unlink()
    note(json.dumps({"cuts": times, "while one was written": between, "file could not be used": refused,
                     "the kept ones stood in": kept}))
    return check(good == times + 1, f"cuts: {good} of {times + 1} starts with the old settings or the new, and a picture")
