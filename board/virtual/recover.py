"""A camera that falters, on the emulated board: it is disconnected, unbound and made to fail, in random order.

The kernel's own trace is the witness: when the program asked for a stream, took a picture from the camera, gave the
display another one, all on the board's clock, where an instruction takes four nanoseconds (a slow board: vivid turns
in a loop all the time, and every instruction costs the emulation). The troubles are those that
the kernel's test camera (vivid) can make; a trouble that shows only when a stream is started is followed by one that
makes the program start one. Checked: the program goes on; pictures are back soon after the camera is; a slate is shown
soon after the last picture; every fault is counted under its cause, no fault that was not made; open files and memory
stay as they were; a camera that is away costs little.
"""

import json
import random
import re
from board import PLAIN_KERNEL, Board, check, note

BACK_MS = 300
SLATE_MS = 300
BUSY = 0.05
BOOT_S = 10

# how often each trouble comes in a full run; by default a twentieth
TROUBLES = {"disconnect": 200, "unbind": 50, "damaged": 50, "reqbufs": 50, "qbuf": 50, "streamon": 50, "fatal": 50,
            "silent 1": 5, "silent 5": 5, "silent 20": 5}

# these cost the emulation more than all others together
LONG = ("silent 5", "silent 20")

VISOR = """
threads = 1
[camera]
source = "v4l2"
device = "/dev/video0"
width = 640
height = 480
fps = 15
[style]
name = "{style}"
[display]
sink = "kms"
scale = "one-to-one"
"""

SCRIPT = r"""
trace=/sys/kernel/tracing
mount -t tracefs trace $trace
echo 0 > $trace/tracing_on
echo mono > $trace/trace_clock
echo {buffer} > $trace/buffer_size_kb
echo 'r:shown drm:drm_mode_page_flip_ioctl refused=$retval:s32' >> $trace/kprobe_events
echo 'r:streams videobuf2_common:vb2_core_streamon refused=$retval:s32' >> $trace/kprobe_events
echo 'r:grabbed videobuf2_common:vb2_core_dqbuf refused=$retval:s32' >> $trace/kprobe_events
echo 1 > $trace/events/kprobes/enable
echo 1 > $trace/tracing_on

mark() { echo "mark $*" > $trace/trace_marker; }
press() { ctl /dev/video0 "$1" 1 || echo "BOARD: refused $1"; }
facts() {
  set -- $1 $(ls /proc/$pid/fd | wc -l) $(awk '/VmData/{print $2}' /proc/$pid/status) \
    $(awk '{print $14+$15}' /proc/$pid/stat) $(cut -d' ' -f1 /proc/uptime)
  echo BOARD: $*
}
disconnect() { mark reopens; press Disconnect; }
fatal() { mark reopens; press "Inject Fatal Streaming Error"; }
reqbufs() { press "Inject VIDIOC_REQBUFS Error"; fatal; }
streamon() { press "Inject VIDIOC_STREAMON Error"; fatal; }
qbuf() { mark reopens; press "Inject VIDIOC_QBUF Error"; }
damaged() { mark drops; press "Inject V4L2_BUF_FLAG_ERROR"; }
silent() {
  ctl /dev/video0 "Percentage of Dropped Buffers" 100; sleep $1
  mark hears; ctl /dev/video0 "Percentage of Dropped Buffers" 0
}
unbind() {
  echo vivid.0 > /sys/bus/platform/drivers/vivid/unbind
  sleep .6; facts lost; sleep 1.5; facts waits
  mark reopens; echo vivid.0 > /sys/bus/platform/drivers/vivid/bind
}

echo BOARD: run
# its log stays in memory: a busy host would be seen as a slow disk
vernissage run --wait --config /host/recover.toml --status /tmp/status.json --json > /tmp/recover.json 2> /tmp/recover.err &
pid=$!
sleep 3
facts before
{troubles}
facts after
sleep 2
cp /tmp/status.json /host/recover-status.json
kill -TERM $pid
wait $pid
ended=$?
cp /tmp/recover.json /tmp/recover.err /host/
cat $trace/trace > /host/recover.trace
echo BOARD: ran $ended
"""


class Witness:
    """What the kernel saw, in ms on the board's clock: (time, what), in order."""

    def __init__(self, text):
        self.events = []
        for line in text.splitlines():
            event = re.match(r"\s*.+-\d+\s.*?\s(\d+\.\d+): (.*)", line)
            if not event:
                continue
            at, what = float(event[1]) * 1e3, event[2]
            if "mark " in what:
                self.events.append((at, what.split("mark ", 1)[1].strip()))
            elif what.endswith("refused=0"):
                self.events.append((at, what.split(":", 1)[0]))

    def after(self, start, *steps):
        """When these have happened one after the other, later than that."""
        at = 0
        for at, what in self.events[start + 1:]:
            if what == steps[0]:
                steps = steps[1:]
                if not steps:
                    return at
        return float("inf")

    def back(self):
        """For every return of the camera, how long until a picture of it was given to the display."""
        ways = {"reopens": ("streams", "grabbed", "shown"), "hears": ("grabbed", "shown")}
        return [self.after(i, *ways[what]) - at for i, (at, what) in enumerate(self.events) if what in ways]

    def slates(self):
        """For every pause of the camera, how long after its last picture the display was given a slate. What the
        display is given so long after a picture is no picture."""
        waits, grabbed = [], None
        for at, what in self.events:
            if what == "grabbed":
                grabbed = at
            elif what == "shown" and grabbed is not None and at - grabbed > 150:
                waits.append(at - grabbed)
                grabbed = None
        return waits

    def longest(self):
        """For every picture that was made to be dropped, the longest time between two pictures on the display then."""
        for begins, what in self.events:
            if what == "drops":
                shown = [at for at, what in self.events if what == "shown" and begins - 100 < at < begins + 800]
                yield max((b - a for a, b in zip(shown, shown[1:])), default=float("inf"))

    def first(self):
        """When the first picture of the camera was given to the display."""
        return self.after(-1, "grabbed", "shown")


def spread(values):
    """Percentiles for people."""
    ordered = sorted(values) or [float("nan")]
    at = lambda share: ordered[min(int(share * len(ordered)), len(ordered) - 1)]
    return f"{len(values)} times, p50 {at(.5):.0f}, p99 {at(.99):.0f}, most {ordered[-1]:.0f} ms", at(.99)


def plan(full):
    """The troubles in random order, the same in every run."""
    counts = {name: count if full else max(name not in LONG, count // 20) for name, count in TROUBLES.items()}
    order = [name for name, count in counts.items() for _ in range(count)]
    chance = random.Random(2006)
    chance.shuffle(order)
    # far enough apart for one trouble to be over before the next, and never in step with the camera
    return counts, "\n".join(f"{name}; sleep {chance.uniform(0.9, 1.2):.3f}" for name in order)


def recover(folder, full):
    """Boots the board with a webcam, makes trouble, judges."""
    host = folder / "host"
    counts, troubles = plan(full)
    for name in ("recover.json", "recover.err", "recover.trace", "recover-status.json"):
        (host / name).unlink(missing_ok=True)
    script = SCRIPT.replace("{troubles}", troubles).replace("{buffer}", str(131072 if full else 16384))
    (host / "run.sh").write_text(script)
    (host / "recover.toml").write_text(VISOR.replace("{style}", "plain" if full else "sketch-like"))
    # a webcam: its pictures cost the board little
    (host / "camera").write_text("node_types=0x1 num_inputs=1 input_types=0x0\n")
    board = Board(folder, "recover", [*PLAIN_KERNEL, "-smp", "1", "-icount", "shift=2,sleep=off"])
    try:
        board.wait_for("ran", 4 * 3600 if full else 900)
    finally:
        board.close(60)
        (host / "camera").unlink()
    log = host / "recover.err"
    if not check(board.said("ran") == "0", f"recover: the program goes on and ends well (exit {board.said('ran')})"):
        for line in (log.read_text() if log.exists() else "").splitlines()[-10:]:
            note(line)
        return
    check(board.said("refused") is None, "recover: the camera takes every order to fail")
    judge_witness(Witness((host / "recover.trace").read_text()), counts)
    judge_costs(board)
    judge_counts(json.loads((host / "recover-status.json").read_text()), counts)


def judge_witness(witness, counts):
    first = witness.first() / 1e3
    check(first <= BOOT_S, f"boot: first stylised picture {first:.1f} s after the kernel's start, at most {BOOT_S}")
    said, p99 = spread(witness.back())
    check(len(witness.back()) == sum(counts.values()) - counts["damaged"] and p99 <= BACK_MS, f"recover: a picture after the camera is back: {said}")
    said, p99 = spread(list(witness.longest()))
    check(len(list(witness.longest())) == counts["damaged"] and p99 <= BACK_MS, f"recover: pause of a damaged picture: {said}")
    said, p99 = spread(witness.slates())
    check(bool(witness.slates()) and p99 <= SLATE_MS, f"recover: a slate after the last picture: {said}")


def judge_costs(board):
    """Open files, memory, and what waiting costs."""
    facts = {word: [tuple(map(float, line.split()[2:])) for line in board.lines if line.startswith(f"BOARD: {word} ")]
             for word in ("before", "lost", "waits", "after")}
    (before,), (after,) = facts["before"], facts["after"]
    check(after[0] == before[0], f"recover: {after[0]:.0f} open files, before {before[0]:.0f}")
    check(after[1] <= before[1] + 1024, f"recover: {after[1]:.0f} KiB of private memory, before {before[1]:.0f}")
    halves = [facts["lost"][:len(facts["lost"]) // 2], facts["lost"][len(facts["lost"]) // 2:]]
    # of a few absences the first ones warm up
    if len(facts["lost"]) >= 20:
        early, late = (max(each[1] for each in half) for half in halves)
        check(late <= early + 256, f"recover: {late:.0f} KiB of private memory in the second half of the absences, {early:.0f} in the first")
    ticks = sum(b[2] - a[2] for a, b in zip(facts["lost"], facts["waits"]))
    time = sum(b[3] - a[3] for a, b in zip(facts["lost"], facts["waits"]))
    check(time > 0 and ticks / 100 / time < BUSY,
          f"recover: {ticks / time:.1f} % of a core while the camera is lost, in {time:.0f} s of it")


def judge_counts(status, counts):
    """Every trouble under its cause, and none besides."""
    faults = {fault["code"]: fault for fault in status["faults"]}
    note(json.dumps(status["faults"]) + " " + json.dumps(status["camera"]))
    check(status["state"] == "run" and not any(fault["now"] for fault in faults.values()), "recover: all is well at the end")
    reopens = sum(counts[name] for name in ("disconnect", "unbind", "reqbufs", "qbuf", "streamon", "fatal"))
    silent = sum(count for name, count in counts.items() if name.startswith("silent"))
    count = lambda code: faults.get(code, {"count": 0})["count"]
    check(count("C1") == reopens, f"recover: camera lost {count('C1')} times, made to {reopens} times")
    check(count("C2") == silent, f"recover: camera silent {count('C2')} times, made to {silent} times")
    others = sorted(set(faults) - {"C1", "C2"})
    check(not others, f"recover: no other fault {' '.join(others)}")
    damaged = status["camera"]["damaged"]
    check(damaged == counts["damaged"], f"recover: {damaged} damaged pictures, made {counts['damaged']}")
    lost = {name: status["camera"][name] for name in ("short", "undecodable")}
    check(not any(lost.values()), f"recover: {lost} besides")
