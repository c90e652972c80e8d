"""A visor that is held up, on the emulated board: once a second all of it stands still for a tenth of a second or longer.

The camera goes on meanwhile and fills its buffers. Checked, by what the program itself tells of capture to shown: the
picture taken after a stall is the newest one, so that 99 of 100 pictures come within one and a half intervals of the
camera and the time they are worked on. Only a picture that was being worked on when the stall began is as late as that.
An instruction takes two nanoseconds on the board's clock, whatever else this machine does.
"""

import json
import random
from board import PLAIN_KERNEL, Board, check, note

FPS = 30
STALL_MS = 100
# how many stalls: in a full run, and by default
STALLS = (120, 30)

VISOR = f"""
threads = 1
[camera]
source = "v4l2"
device = "/dev/video0"
width = 320
height = 180
fps = {FPS}
[style]
name = "plain"
[display]
sink = "kms"
scale = "one-to-one"
"""

SCRIPT = r"""
vernissage run --wait --config /host/stalls.toml --status /tmp/status.json > /tmp/stalls.out 2> /tmp/stalls.err &
pid=$!
# its files come from the other machine, which has a clock of its own
until grep -q '"shown": [1-9]' /tmp/status.json; do kill -0 $pid || break; sleep .2; done 2> /dev/null
echo BOARD: run
stall() { kill -STOP $pid; sleep $1; kill -CONT $pid; sleep $2; }
{stalls}
sleep 1.5
cp /tmp/status.json /host/stalls-status.json
kill -TERM $pid
wait $pid
ended=$?
cp /tmp/stalls.err /host/
echo BOARD: ran $ended
"""


def stalls(folder, full):
    """Boots the board with a webcam, stalls the program, judges."""
    host, times = folder / "host", STALLS[0 if full else 1]
    for name in ("stalls.err", "stalls-status.json"):
        (host / name).unlink(missing_ok=True)
    (host / "stalls.toml").write_text(VISOR)
    # never in step with the camera: up to an interval longer, at any time of an interval
    chance = random.Random(2006)
    seconds = [(STALL_MS / 1e3 + chance.uniform(0, 1 / FPS), chance.uniform(0.85, 0.95)) for _ in range(times)]
    script = SCRIPT.replace("{stalls}", "\n".join(f"stall {held:.4f} {free:.4f}" for held, free in seconds))
    (host / "run.sh").write_text(script)
    (host / "camera").write_text("node_types=0x1 num_inputs=1 input_types=0x0\n")
    board = Board(folder, "stalls", [*PLAIN_KERNEL, "-smp", "1", "-icount", "shift=1,sleep=off"])
    try:
        board.wait_for("ran", 1200)
    finally:
        board.close(30)
        (host / "camera").unlink()
    if not check(board.said("ran") == "0", f"stalls: the program goes on and ends well (exit {board.said('ran')})"):
        return
    status = json.loads((host / "stalls-status.json").read_text())
    latency, camera = status["latency_ms"], status["camera"]
    work = sum(ms for stage, ms in status["stages_ms"].items() if stage != "camera")
    bound = 1.5 * 1e3 / FPS + work
    note(f"{status['frames']['shown']} pictures shown, stages {json.dumps(status['stages_ms'])}, {json.dumps(camera)}")
    check(camera["stale"] + camera["missed"] >= times, f"stalls: {camera['stale']} pictures of the camera were too old"
          f" to be shown and {camera['missed']} had no buffer, in {times} stalls of {STALL_MS} ms")
    check(latency["p99"] <= bound, f"stalls: capture to shown p50 {latency['p50']:.1f}, p99 {latency['p99']:.1f} ms,"
          f" at most {bound:.1f}: 1.5 intervals and {work:.1f} ms of work")
