"""What finding and following a marker costs on the emulated board: `detect` on pictures of the program's own clip, on a
clock that counts instructions (test.py's clock run boots the board). Pictures searched whole cost what they cost the
second time on; a followed marker what it costs once its motion is known.
"""

import json
import statistics
from board import CLIP, HEIGHT, WIDTH, check, run

FRAMES = 16
# pictures of the clip that are searched whole
WHOLE = (0, 5, 10, 15)
# frames until the motion is known
WARM = 6
# million ARM instructions: a picture searched whole, and a picture with one marker followed
BUDGET = {"whole": 10, "followed": 1}

SCRIPT = """
vernissage detect --job /host/whole.jsonl --repeat 3 --threads 1 > /host/whole.out 2>> /host/clock.err || echo BOARD: ran 1
vernissage detect --job /host/followed.jsonl --mode track --threads 1 > /host/followed.out 2>> /host/clock.err \\
  || echo BOARD: ran 1
"""


def make(host, folder):
    """Draws the pictures and writes the jobs."""
    for name in ("whole.out", "followed.out"):
        (folder / "host" / name).unlink(missing_ok=True)
    (folder / "clip.toml").write_text(CLIP.format(frames=FRAMES))
    clip = folder / "clip.y4m"
    if run([host, "render", "--config", folder / "clip.toml", "--out", clip], 120) is None:
        return check(False, "clock: a clip made by the program")
    focal = 1.05 * WIDTH
    camera = {"w": WIDTH, "h": HEIGHT, "fx": focal, "fy": focal, "cx": (WIDTH - 1) / 2, "cy": (HEIGHT - 1) / 2,
              "dist": [0, 0, 0, 0, 0]}
    lines = []
    with open(clip, "rb") as pictures:
        pictures.readline()
        while pictures.readline().startswith(b"FRAME"):
            luma, *_ = (pictures.read(WIDTH * HEIGHT) for _ in range(3))
            name, number = f"marker-{len(lines)}.pgm", len(lines)
            (folder / "host" / name).write_bytes(b"P5\n%d %d\n255\n" % (WIDTH, HEIGHT) + luma)
            lines.append({"image": f"/host/{name}", "family": "tag36h11", "size": 80, "camera": camera, "seq": 1,
                          "frame": number})
    clip.unlink()
    whole = [{**lines[k], "seq": None, "frame": None} for k in WHOLE]
    for name, job in (("followed", lines), ("whole", whole)):
        (folder / "host" / f"{name}.jsonl").write_text("".join(json.dumps(line) + "\n" for line in job))
    return True


def judge(folder):
    """A millisecond of the board's clock is a million instructions."""
    said = {name: [json.loads(line) for line in (folder / "host" / f"{name}.out").read_text().splitlines()]
            for name in BUDGET}
    seen = sum(len(line["detections"]) == 1 for lines in said.values() for line in lines)
    check(seen == FRAMES + len(WHOLE), f"clock: the marker seen in {seen} of {FRAMES + len(WHOLE)} pictures")
    costs = {"whole": [min(line["ms"]) for line in said["whole"]],
             "followed": [line["ms"][0] for line in said["followed"][WARM:]]}
    for name, budget in BUDGET.items():
        cost = statistics.mean(costs[name])
        check(cost <= budget, f"clock: marker, {name}: {cost:.2f} million instructions a picture ({min(costs[name]):.2f} to "
              f"{max(costs[name]):.2f}), at most {budget}")
