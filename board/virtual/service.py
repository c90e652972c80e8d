#!/usr/bin/env python3
"""The service under a real systemd: Debian's own, first process of the emulated ARM board.

usage: service.py [--host BINARY] [--dir DIR] [--skip-build] [--soak]

The repository's unit, target, users, folders and device rules are installed by the very lines of
`systemd/README.md`; the board then starts into the kiosk target. Checked, on the board's clock:

no display   the service is not ready, not given up and not started again: it says what it waits for; no start limit
ready        once the display's driver is loaded, and not before the kernel took the first picture; the screen
             shows the camera's pictures
sandbox      an unprivileged user has camera, display and a button board that is plugged in later; a press is
             acted on; `systemd-analyze` finds no mistake and an exposure of at most .6
steady       not a byte written to disk
hung         SIGSTOP to the program: a new picture within 4 s
killed       SIGKILL, 5 times (100 with --soak): always a new picture

An instruction takes two nanoseconds of the board's clock, so the bounds hold however busy this machine is. Needs what
install.sh installs, and root. Prints PASS or FAIL lines; exit code 1 when anything failed. DIR (default
target/virtual-board) keeps service.log, and in host/ the journal and the kernel's trace.
"""

import argparse
import os
import re
import shutil
import statistics
import sys
import time
from pathlib import Path

sys.dont_write_bytecode = True  # nothing is left beside the sources
from board import (HEIGHT, HERE, PLAIN_KERNEL, ROOT, STEADY_CLOCK, WIDTH, Board, Buttons, check, make_clip, note,
                   read_ppm, run, verdict)

FRAMES = 8
EXPOSURE = 0.6
PICTURE_MS = 4000

VISOR = """
threads = 1
[camera]
source = "v4l2"
device = "/dev/vernissage/camera0"
width = 640
height = 480
[style]
name = "plain"
[display]
sink = "kms"
scale = "one-to-one"
[serial]
port = "/dev/vernissage/buttons"
[[serial.button]]
number = 1
short = "freeze"
"""

# the test's own service, beside the visor's; the log stays in memory, as on a read-only image
INSTALL = r"""
cat > /etc/systemd/system/board-test.service << end
[Service]
ExecStart=/bin/sh /host/service.sh
end
ln -s ../board-test.service /etc/systemd/system/vernissage-kiosk.target.wants/
mkdir -p /etc/systemd/journald.conf.d
printf '[Journal]\nStorage=volatile\n' > /etc/systemd/journald.conf.d/board.conf
"""

SCRIPT = r"""
exec > /dev/ttyAMA0 2>&1
trace=/sys/kernel/tracing
echo BOARD: up $(cat /proc/uptime)
show() { systemctl show vernissage --value -p "$1"; }
uptime() { cut -d' ' -f1 /proc/uptime; }
# waits for a shell condition, so many seconds of the board's clock
await() {
  local limit=$(($(uptime | cut -d. -f1) + $1))
  until eval "$2"; do
    [ $(uptime | cut -d. -f1) -lt $limit ] || return 1
    sleep .5
  done
}
host() { await 600 "[ -e /host/done-$1 ]"; }
# another process that is ready
fresh() {
  await 60 'eval $(systemctl show vernissage -p ActiveState,MainPID)
            [ $ActiveState = active ] && [ $MainPID != '"$1"' ]'
}
mark() { echo "mark $*" > $trace/trace_marker; }
ready() { mark "ready $(show ActiveEnterTimestampMonotonic) $(show MainPID)"; }

mount -t tracefs trace $trace 2> /dev/null
modprobe -a drm_shmem_helper drm_kms_helper virtio_dma_buf
echo mono > $trace/trace_clock
echo 4096 > $trace/buffer_size_kb
echo 'r:picture drm:drm_mode_page_flip_ioctl refused=$retval:s32' > $trace/kprobe_events
echo 1 > $trace/events/kprobes/picture/enable

# longer than it may take to start
sleep {blind}
echo BOARD: blind $(uptime) $(show NRestarts) $(show ActiveEnterTimestampMonotonic) \
  $(show StartLimitIntervalUSec) $(show ActiveState) $(show StatusText)
mark card
insmod /usr/lib/board/virtio-gpu.ko
fresh 0 && ready
pid=$(show MainPID)
echo BOARD: seeing $(uptime) $(show ActiveState)
host looked

echo BOARD: buttons $(show ActiveState)
await 10 'ls -l /proc/$pid/fd | grep -q ttyUSB0' && echo BOARD: plugged 1 || echo BOARD: plugged 0
journalctl --no-pager -b -o short-monotonic > /host/journal.txt
host pressed
grep -E '^(Uid|Groups|CapEff|NoNewPrivs|Seccomp):' /proc/$pid/status | tr '\n\t' '  ' | sed 's/^/BOARD: rights /'; echo
for node in /dev/video0 /dev/dri/card0 /dev/ttyUSB0; do
  echo "BOARD: node $node $(stat -c '%U:%G %a' $node) $(ls -l /proc/$pid/fd | grep -c " $node\$")"
done
echo BOARD: names $(readlink /dev/vernissage/camera0) $(readlink /dev/vernissage/buttons)
grep -E '^(video|render|dialout|input):' /etc/group | tr '\n' ' ' | sed 's/^/BOARD: groups /'; echo
systemd-analyze --man=no verify vernissage.service vernissage-kiosk.target > /host/verify.txt 2>&1
echo BOARD: verify $? $(wc -c < /host/verify.txt)
echo BOARD: exposure $(systemd-analyze --no-pager security vernissage.service | tail -1)

# that the disk's counter counts
sync
before=$(awk '{print $7}' /sys/block/vda/stat)
dd if=/dev/zero of=/var/proof bs=4096 count=16 2> /dev/null; sync; rm /var/proof
echo BOARD: control $(($(awk '{print $7}' /sys/block/vda/stat) - before))
sleep 1; sync
written() { awk '/^write_bytes/{print $2}' /proc/$pid/io; awk '{print $7}' /sys/block/vda/stat; }
before=$(written)
mark steady
sleep {steady}
sync
mark unsteady
echo BOARD: steady $pid $(show MainPID) $before $(written)

for n in $(seq {hung}); do
  pid=$(show MainPID); mark hung $pid; kill -STOP $pid; fresh $pid && ready; sleep 1
done
for n in $(seq {killed}); do
  pid=$(show MainPID); mark killed $pid; kill -KILL $pid; fresh $pid && ready
done
echo BOARD: back $(show ActiveState) $(show NRestarts)
host seen
journalctl --no-pager -b -o short-monotonic > /host/journal.txt
cat $trace/trace > /host/service.trace
echo BOARD: end
systemctl show vernissage > /host/service.show
poweroff -f
"""

def installation():
    """The lines of systemd/README.md for a machine that is started then."""
    text = (ROOT / "systemd" / "README.md").read_text()
    return "set -e\ncd /host/tree\n" + re.search(r"^```\n(install .*?)^```", text, re.S | re.M)[1]


def lay_out(folder, soak):
    """What the board finds below /host."""
    host = folder / "host"
    for old in ("done-looked", "done-pressed", "done-seen", "journal.txt", "service.trace", "verify.txt"):
        (host / old).unlink(missing_ok=True)
    tree = host / "tree"
    shutil.rmtree(tree, ignore_errors=True)
    shutil.copytree(ROOT / "systemd", tree / "systemd")
    (tree / "target" / "release").mkdir(parents=True)
    (tree / "board").mkdir()
    shutil.copy(folder / "vernissage", tree / "target" / "release")
    # in the place of the board file that the lines name
    (tree / "board" / "rpi4.toml").write_text(VISOR)
    (host / "install.sh").write_text(installation() + INSTALL)
    script = SCRIPT
    for word, value in {"blind": 180 if soak else 35, "steady": 600 if soak else 60, "hung": 10 if soak else 1,
                        "killed": 100 if soak else 5}.items():
        script = script.replace("{%s}" % word, str(value))
    (host / "service.sh").write_text(script)
    frame = WIDTH * HEIGHT * 2
    with open(host / "clip.yuyv", "rb") as clip:
        (host / "service.yuyv").write_bytes(clip.read(FRAMES * frame))


def looked_at(board, folder, name, seconds=120):
    """Waits until the screen shows a picture of the clip, and then another: their numbers, as far as seen."""
    path, seen = folder / f"service-{name}.ppm", []
    luma = (folder / "host" / "service.yuyv").read_bytes()[0::2]
    area, some = WIDTH * HEIGHT, range(0, WIDTH * HEIGHT, 101)
    end = time.monotonic() + seconds
    while len(seen) < 2 and time.monotonic() < end and board.process.poll() is None:
        board.command(f"screendump {path}", 60)
        screen = read_ppm(path) if path.exists() else None
        if screen and screen[:2] == (WIDTH, HEIGHT):
            rgb = screen[2]
            # BT.601, limited range, as the clip is
            shown = [16 + (65.5 * rgb[3 * i] + 128.6 * rgb[3 * i + 1] + 25 * rgb[3 * i + 2]) / 255 for i in some]
            errors = [statistics.fmean(abs(luma[k * area + i] - y) for i, y in zip(some, shown)) for k in range(FRAMES)]
            best = min(range(FRAMES), key=errors.__getitem__)
            if errors[best] < 1.5 and best not in seen:
                seen.append(best)
        time.sleep(0.5)
    return seen


class Trace:
    """Times in ms on the board's clock: pictures that the kernel took, and the script's marks."""

    def __init__(self, text):
        self.events = []
        for line in text.splitlines():
            event = re.match(r"\s*(.+)-(\d+)\s.*?\s(\d+\.\d+): (.*)", line)
            if event and event[4].startswith("picture:") and event[4].endswith("refused=0"):
                self.events.append((float(event[3]) * 1e3, "picture", []))
            elif event and "mark " in event[4]:
                word, *rest = event[4].split("mark ", 1)[1].split()
                self.events.append((float(event[3]) * 1e3, word, rest))

    def after(self, start, word):
        """The first such event later than that."""
        return next((event for event in self.events if event[0] > start and event[1] == word), None)

    def returns(self, word):
        """From every such mark to the next picture; ready minus that picture; whether another process showed it."""
        for at, _, rest in [event for event in self.events if event[1] == word]:
            picture, ready = self.after(at, "picture"), self.after(at, "ready")
            if not picture or not ready:
                yield float("inf"), float("nan"), False
            else:
                yield picture[0] - at, int(ready[2][0]) / 1e3 - picture[0], ready[2][1:] != rest


def figures(values):
    return f"{min(values):.0f} / {statistics.median(values):.0f} / {max(values):.0f} ms (min/median/max)"


def judge_trace(trace, hung, killed):
    """Readiness and returns, from what the kernel wrote down."""
    for word, count, what in (("card", 1, "display plugged in"), ("hung", hung, "hung"), ("killed", killed, "killed")):
        found = list(trace.returns(word))
        pictures, ready, other = ([each[i] for each in found] for i in range(3))
        bound = 60000 if word == "card" else PICTURE_MS
        check(len(found) == count and all(other) and max(pictures, default=0) <= bound,
              f"{what}: {len(found)} of {count} times a picture after {figures(pictures or [0])}, at most {bound}")
        check(len(ready) == count and all(0 <= after <= 1000 for after in ready),
              f"{what}: ready {figures(ready or [-1])} after the first picture, never before it")


def boot(folder, soak):
    lay_out(folder, soak)
    hung, killed = (10, 100) if soak else (1, 5)
    buttons = Buttons(folder)
    board = Board(folder, "service", [
        "-initrd", "debian.gz", "-drive", "file=debian.ext4,if=virtio,format=raw,snapshot=on",
        "-device", "qemu-xhci", "-chardev", f"serial,id=buttons,path={buttons.link}",
        *PLAIN_KERNEL, *STEADY_CLOCK])
    host = folder / "host"
    began = time.monotonic()
    late = 3600 if soak else 900

    def told(word, seconds=900):
        arrived = board.wait_for(word, seconds)
        note(f"{word}: {time.monotonic() - began:.0f} s of this machine's time")
        return (board.said(word) or "").split() if arrived else None

    try:
        blind = told("blind")
        if not check(blind is not None and board.said("install failed") is None, "board: starts into the kiosk target"):
            return
        check(blind[1:5] == ["0", "0", "0", "activating"] and blind[5:7] == ["nothing", "to"],
              f"no display: never ready in {blind[0]} s, {blind[4]} ({' '.join(blind[5:])}), started again {blind[1]} times")
        seeing = told("seeing") or ["", ""]
        check(seeing[1] == "active", f"display: service is {seeing[1]} once its driver is loaded")
        seen = looked_at(board, folder, "first")
        check(len(seen) == 2, f"display: the screen shows the camera's pictures ({len(seen)} different ones seen)")
        (host / "done-looked").touch()

        told("buttons")
        board.command("device_add usb-serial,chardev=buttons,id=buttons0", 60)
        plugged = told("plugged")
        check(plugged == ["1"], "buttons: a board plugged in while the service runs is opened")
        if plugged == ["1"] and check(buttons.wait_for(" OK", 1, 60), "buttons: the board and the visor shake hands"):
            for count in (1, 2):
                buttons.press()
                if not check(buttons.wait_for("ACT 1 freeze ok", count, 60), "buttons: a press is acted on"):
                    break
        (host / "done-pressed").touch()
        judge_rights(board, told)

        control = told("control")
        steady = list(map(int, told("steady", late) or []))
        check(control is not None and int(control[0]) >= 128,
              f"steady: 64 KiB of ours are counted ({control and control[0]} sectors)")
        check(len(steady) == 6 and steady[0] == steady[1] and steady[2] == steady[4],
              f"steady: {steady[4] - steady[2] if steady else '?'} bytes written by the program")
        check(len(steady) == 6 and steady[3] == steady[5],
              f"steady: {(steady[5] - steady[3]) * 512 if steady else '?'} bytes written to disk by the whole board")

        back = told("back", late) or ["", ""]
        check(back[0] == "active", f"killed: service is {back[0]} after {back[1]} starts")
        seen = looked_at(board, folder, "last")
        check(len(seen) == 2, f"killed: the screen shows the camera's pictures ({len(seen)} different ones seen)")
        (host / "done-seen").touch()
        if check(told("end") is not None, "board: comes to the end"):
            trace = Trace((host / "service.trace").read_text())
            start, end = (next((e[0] for e in trace.events if e[1] == word), 0.0) for word in ("steady", "unsteady"))
            count = sum(start < event[0] < end and event[1] == "picture" for event in trace.events)
            check(count > end / 1e3 - start / 1e3, f"steady: {count} pictures in {(end - start) / 1e3:.1f} s")
            judge_trace(trace, hung, killed)
    except OSError as error:
        check(False, f"board: monitor: {error}")
    finally:
        check(board.close(20), "board: powers off by itself")
        buttons.close()


def judge_rights(board, told):
    """Who the program runs as, and what it has open."""
    told("exposure")
    rights = board.said("rights") or ""
    groups = {line.split(":")[2]: line.split(":")[0] for line in (board.said("groups") or "").split()}
    words = re.split(r"(\w+): ", rights)[1:]
    fields = {name: value.strip() for name, value in zip(words[::2], words[1::2])}
    user = fields.get("Uid", "0").split()[0]
    member = sorted(groups.get(group, "") for group in fields.get("Groups", "").split())
    check(user != "0" and fields.get("CapEff", "").strip("0") == "" and fields.get("NoNewPrivs") == "1"
          and fields.get("Seccomp") == "2" and set(member) >= {"dialout", "input", "render", "video"},
          f"sandbox: user {user}, no capabilities, filtered calls, groups {' '.join(filter(None, member))}")
    nodes = [line[len("BOARD: node "):] for line in board.lines if line.startswith("BOARD: node ")]
    ours = r"/dev/(video0|dri/card0|ttyUSB0) root:(video|dialout) 660 [1-9]\d*"
    good = [node for node in nodes if re.fullmatch(ours, node)]
    check(len(good) == len(nodes) == 3, f"sandbox: camera, display and buttons are open: {', '.join(nodes)}")
    check(board.said("names") == "../video0 ../ttyUSB0", f"rules: camera0 and buttons are {board.said('names')}")
    check(board.said("verify") == "0 0", "systemd-analyze verify: no mistake found")
    exposure = re.search(r"vernissage.service: (\d+\.\d+)", board.said("exposure") or "")
    check(bool(exposure) and float(exposure[1]) <= EXPOSURE,
          f"systemd-analyze security: exposure {exposure[1] if exposure else '?'}, at most {EXPOSURE}")


def main():
    arguments = argparse.ArgumentParser(description="The service under a real systemd.")
    arguments.add_argument("--host", type=Path, help="the program for this machine, to draw a clip")
    arguments.add_argument("--dir", type=Path, default=ROOT / "target" / "virtual-board")
    arguments.add_argument("--skip-build", action="store_true", help="use the board as it is in DIR")
    arguments.add_argument("--soak", action="store_true", help="100 kills, 10 hangs, 10 minutes of steady running")
    chosen = arguments.parse_args()
    folder = chosen.dir.resolve()
    (folder / "host").mkdir(parents=True, exist_ok=True)
    if not chosen.skip_build and run(["bash", HERE / "build.sh", folder], 1800) is None:
        return 1
    if not check(run(["bash", HERE / "debian.sh", folder], 600) is not None, "build: a disk with Debian's systemd"):
        return 1
    if not (folder / "host" / "clip.yuyv").exists():
        host = chosen.host or ROOT / "target" / "release" / "vernissage"
        if not make_clip(host.resolve(), folder, 60):
            return 1
    os.chdir(folder)
    began = time.monotonic()
    boot(folder, chosen.soak)
    note(f"{time.monotonic() - began:.0f} s, logs in {folder}")
    return verdict("service")


if __name__ == "__main__":
    sys.exit(main())
