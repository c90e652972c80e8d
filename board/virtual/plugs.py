"""Plugs that are pulled: the screen's cable, the screen's mastership, the button board's USB plug.

screen   The connector goes off and on; then another program has the screen for a while. A camera that stands still
         shows the same picture every time, so after each return the emulated screen is compared with the picture that
         this machine draws, byte for byte. How soon it is back is the kernel's trace's to say, on the board's clock.
buttons  An emulated USB serial adapter with the button board's simulator behind it is plugged in and pulled out. Every
         press made while it is plugged is acted on once; nothing else is acted on. In real time: the simulator's.
"""

import json
import shutil
import time
from board import PLAIN_KERNEL, STEADY_CLOCK, Board, Buttons, check, note, read_png, read_ppm, run
from recover import Witness, spread

BACK_MS = 500
# how often: in a full run, and by default
SCREEN_TIMES, USB_TIMES = (50, 3), (100, 5)

STILL = """
threads = 1
[camera]
source = "synthetic"
width = 640
height = 480
fps = 5
[camera.synthetic]
noise = 0
pace = 0
samples = 1
{frames}
[style]
name = "plain"
[display]
sink = "kms"
scale = "one-to-one"
"""

SCREEN_SCRIPT = r"""
trace=/sys/kernel/tracing
mount -t tracefs trace $trace
echo mono > $trace/trace_clock
echo 8192 > $trace/buffer_size_kb
echo 'r:shown drm:drm_mode_page_flip_ioctl refused=$retval:s32' > $trace/kprobe_events
echo 1 > $trace/events/kprobes/enable
mark() { echo "mark $*" > $trace/trace_marker; }
cable() { echo $1 > /sys/class/drm/card0-Virtual-1/status; }
# open files, and the private memory asked for: what is resident also grows whenever a page is touched first
facts() { echo BOARD: $1 $(ls /proc/$pid/fd | wc -l) $(awk '/VmData/{print $2}' /proc/$pid/status); }
# waits until the other machine has looked at the screen
looked() { echo BOARD: look-$1; until [ -e /host/done-$1 ]; do sleep .2; done; }

vernissage run --wait --config /host/plugs.toml --status /tmp/status.json > /tmp/plugs.out 2> /tmp/plugs.err &
pid=$!
# its files come from the other machine, which has a clock of its own
until grep -q '"shown": [1-9]' /tmp/status.json; do kill -0 $pid || break; sleep .2; done 2> /dev/null
looked first
for n in $(seq {times}); do
  cable off; sleep 1.7
  mark returns; cable detect; sleep 1
  looked cable-$n
  facts flat
  cable off; sleep 1.7
  hold /dev/dri/card0 2500 > /tmp/held & other=$!
  sleep .2; cable detect
  for i in $(seq 50); do grep -q holding /tmp/held && break; sleep .1; done
  sleep .7
  looked other-$n
  wait $other || echo BOARD: refused
  mark returns; sleep 1
  looked master-$n
  facts flat
done
cp /tmp/status.json /host/plugs-status.json
cat $trace/trace > /host/plugs.trace
kill -TERM $pid
wait $pid
ended=$?
cp /tmp/plugs.err /host/
echo BOARD: ran $ended
"""

BUTTONS = """
threads = 1
[camera]
source = "synthetic"
width = 160
height = 120
fps = 10
[style]
name = "plain"
[display]
sink = "null"
[serial]
port = "/dev/ttyUSB0"
[[serial.button]]
number = 1
short = "freeze"
"""

USB_SCRIPT = r"""
for module in $(cat /mods/usb); do insmod /mods/$module; done
# open files, and the private memory asked for: what is resident also grows whenever a page is touched first
facts() { echo BOARD: $1 $(ls /proc/$pid/fd | wc -l) $(awk '/VmData/{print $2}' /proc/$pid/status); }
vernissage run --config /host/plugs.toml > /tmp/plugs.out 2> /tmp/plugs.err &
pid=$!
echo BOARD: run
until [ -e /host/done-warm ]; do sleep .2; done
facts flat
until [ -e /host/done-usb ]; do sleep .2; done
facts flat
kill -TERM $pid
wait $pid
ended=$?
cp /tmp/plugs.err /host/
echo BOARD: ran $ended
"""


def clear(host, *names):
    for old in [*host.glob("done-*"), *(host / name for name in names)]:
        old.unlink(missing_ok=True)


def flat(board):
    """Open files and memory in the second half as in the first."""
    facts = [tuple(map(int, line.split()[2:])) for line in board.lines if line.startswith("BOARD: flat ")]
    if not check(len(facts) >= 2, f"plugs: files and memory looked at {len(facts)} times"):
        return
    half = len(facts) // 2
    files, memory = (([each[i] for each in facts[:half]], [each[i] for each in facts[half:]]) for i in (0, 1))
    check(max(files[1]) <= max(files[0]) and max(memory[1]) <= max(memory[0]) + 512,
          f"plugs: at most {max(files[1])} open files and {max(memory[1])} KiB of private memory in the second half,"
          f" {max(files[0])} and {max(memory[0])} in the first")


def screen(host_binary, folder, full):
    """Connector and mastership."""
    times = SCREEN_TIMES[0 if full else 1]
    host = folder / "host"
    clear(host, "plugs.err", "plugs.trace", "plugs-status.json")
    (folder / "plugs.toml").write_text(STILL.replace("{frames}", "frames = 1"))
    reference = folder / "plugs"
    if run([host_binary, "render", "--config", folder / "plugs.toml", "--out", reference], 120) is None:
        return check(False, "screen: the picture drawn here")
    expected = read_png(next(reference.glob("*.png")))
    (host / "plugs.toml").write_text(STILL.replace("{frames}", ""))
    (host / "run.sh").write_text(SCREEN_SCRIPT.replace("{times}", str(times)))
    (host / "camera").write_text("node_types=0x1 num_inputs=1 input_types=0x0\n")
    board = Board(folder, "screen", [*PLAIN_KERNEL, *STEADY_CLOCK])
    path, true, others = folder / "plugs.ppm", [], []
    for old in folder.glob("plugs-*.ppm"):
        old.unlink()

    def looks(name):
        if not board.wait_for(f"look-{name}", 300):
            return False
        board.command(f"screendump {path}", 60)
        shown = read_ppm(path)
        if name.startswith("other"):
            others.append(shown is not None and shown[2] == b"\x40\x80\xc0" * (shown[0] * shown[1]))
        else:
            true.append(shown == expected)
            if not true[-1]:
                shutil.copy(path, folder / f"plugs-{name}.ppm")
                note(f"{name}: another picture, kept as plugs-{name}.ppm")
        (host / f"done-{name}").touch()
        return True

    try:
        names = [f"{who}-{n + 1}" for n in range(times) for who in ("cable", "other", "master")]
        all(looks(name) for name in ["first", *names])
        board.wait_for("ran", 120)
    except OSError as error:
        check(False, f"screen: monitor: {error}")
    finally:
        board.close(30)
        (host / "camera").unlink()
    if not check(board.said("ran") == "0", f"screen: the program goes on and ends well (exit {board.said('ran')})"):
        return tell(host)
    returns = 1 + 2 * times
    check(len(true) == returns and all(true), f"screen: {sum(true)} of {returns} times the picture, byte for byte")
    check(len(others) == times and all(others) and board.said("refused") is None,
          f"screen: {sum(others)} of {times} times another program's picture between")
    witness = Witness((host / "plugs.trace").read_text())
    back = [witness.after(i, "shown") - at for i, (at, what) in enumerate(witness.events) if what == "returns"]
    said, _ = spread(back)
    check(len(back) == 2 * times and max(back) <= BACK_MS, f"screen: back within {BACK_MS} ms: {said}")
    status = (host / "plugs-status.json").read_text()
    faults = {fault["code"]: fault["count"] for fault in json.loads(status)["faults"]}
    check(faults == {"D1": 2 * times, "D2": times}, f"screen: faults counted {faults}")
    return flat(board)


def buttons(folder, full):
    """The button board's USB plug."""
    times = USB_TIMES[0 if full else 1]
    host = folder / "host"
    clear(host, "plugs.err")
    (host / "plugs.toml").write_text(BUTTONS)
    (host / "run.sh").write_text(USB_SCRIPT)
    simulator = Buttons(folder)
    board = Board(folder, "usb", ["-device", "qemu-xhci", "-chardev", f"serial,id=buttons,path={simulator.link}"])
    came, acted, waits = 0, 0, []
    try:
        if not check(board.wait_for("run", 120), "buttons: board boots"):
            return None
        for n in range(times):
            before = simulator.heard(" OK")
            plugged = time.monotonic()
            board.command(f"device_add usb-serial,chardev=buttons,id=plug{n}", 60)
            came += simulator.wait_for(" OK", before + 1, 20)
            waits.append((time.monotonic() - plugged) * 1e3)
            before = simulator.heard("ACT 1 freeze ok")
            simulator.press()
            acted += simulator.wait_for("ACT 1 freeze ok", before + 1, 10)
            if n == 0:
                (host / "done-warm").touch()
                board.wait_for("flat", 20)
            board.command(f"device_del plug{n}", 60)
            # nobody hears it, and nothing may come of it
            simulator.press()
            time.sleep(0.4)
        (host / "done-usb").touch()
        board.wait_for("ran", 60)
    except OSError as error:
        check(False, f"buttons: monitor: {error}")
    finally:
        board.close(30)
        said = simulator.heard("ACT 1 ")
        simulator.close()
    if not check(board.said("ran") == "0", f"buttons: the program goes on and ends well (exit {board.said('ran')})"):
        return tell(host)
    check(came == times, f"buttons: plugged in {times} times, board and visor shake hands {came} times: {spread(waits)[0]}")
    check(acted == times and said == times, f"buttons: {times} presses, {acted} acted on, {said} told of")
    return flat(board)


def tell(host):
    log = host / "plugs.err"
    for line in (log.read_text() if log.exists() else "").splitlines()[-10:]:
        note(line)


def plugs(host_binary, folder, full):
    """Both."""
    screen(host_binary, folder, full)
    buttons(folder, full)
