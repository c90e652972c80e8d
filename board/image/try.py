#!/usr/bin/env python3
"""The card image on an emulated board: starts, shows, and stands what happens to cards.

usage: try.py [--host BINARY] [--dir DIR] [--image FILE]

The image that build.sh made (DIR/visor.img, default target/image) is copied; its settings are changed as a technician
would, on the card in another computer. Every run ends with a power cut. Checked:

first      boots into the visor; the screen shows what the settings on the card say, byte for byte
changed    other settings on the card: shown at the next start
mistake    a mistake in them: the screen says so, then shows what was good last
worn       the state partition is garbage: what the card says is shown all the same
empty      neither settings nor state: the screen says so
untouched  the card's partition and the root are the same bytes before and after every run

Needs what install.sh installs. Prints PASS or FAIL lines; exit code 1 when anything failed. No bound rests on this
machine's time. DIR keeps the firmware's consoles and the last screen of every run.
"""

import argparse
import hashlib
import os
import shutil
import sys
import time
from pathlib import Path

sys.dont_write_bytecode = True  # nothing is left beside the sources
HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "virtual"))
from board import ROOT, Board, check, note, read_png, read_ppm, run, verdict

# a still camera: every picture is the same
VISOR = """
threads = 2
[camera]
source = "synthetic"
width = 640
height = 480
[camera.synthetic]
noise = 0
pace = 0
[style]
name = "{style}"
fade_ms = 0
[display]
sink = "kms"
"""
PATIENCE = 600
MEBIBYTE = 1 << 20


class Card:
    """A copy of the image, and its partitions."""

    def __init__(self, image, path):
        self.path = path
        shutil.copy(image, path)
        listed = run(["/sbin/sfdisk", "--dump", path], 60) or ""
        rows = [dict(part.split("=") for part in line.split(":")[1].replace(" ", "").split(",") if "=" in part)
                for line in listed.splitlines() if "start=" in line]
        self.parts = [(int(row["start"]) * 512, int(row["size"]) * 512) for row in rows]

    def read(self, part):
        start, size = self.parts[part]
        with open(self.path, "rb") as file:
            file.seek(start)
            return file.read(size)

    def hashes(self):
        """Of the card's partition and the root."""
        return [hashlib.sha256(self.read(part)).hexdigest() for part in (0, 1)]

    def write_settings(self, text):
        """Puts a settings file on the card, or takes it away."""
        where = ["-i", f"{self.path}@@{self.parts[0][0]}"]
        source = self.path.with_suffix(".toml")
        source.write_text(text or "")
        done = run(["mcopy", "-o", *where, source, "::visor.toml"] if text else ["mdel", *where, "::visor.toml"], 60)
        return check(done is not None, "card: settings written" if text else "card: settings deleted")

    def spoil_state(self):
        start, size = self.parts[2]
        with open(self.path, "r+b") as file:
            file.seek(start)
            file.write(os.urandom(MEBIBYTE) * (size // MEBIBYTE))


def rendered(host, folder, style):
    """The picture that the screen must show."""
    config = folder / f"{style}.toml"
    config.write_text(VISOR.format(style=style).replace("threads = 2", "").replace("noise", "frames = 1\nnoise"))
    out = folder / style
    shutil.rmtree(out, ignore_errors=True)
    if run([host, "render", "--config", config, "--out", out], 120) is None:
        return None
    return read_png(sorted(out.glob("*.png"))[0])[2]


def is_slate(pixels):
    """Light words on a dark ground, all gray."""
    gray = pixels[0::3] == pixels[1::3] == pixels[2::3]
    light = sum(value > 100 for value in pixels[0::3])
    dark = sum(value == 16 for value in pixels[0::3])
    return gray and light > 2000 and dark > 200_000


def boot(card, folder, name, wanted):
    """Runs the card until the screen showed all that is wanted, in turn: how many of those were seen."""
    before = card.hashes()
    board = Board(folder, name, [card.path.name], HERE / "boot.sh")
    screen = folder / f"{name}.ppm"
    seen, began = 0, time.monotonic()
    try:
        while seen < len(wanted) and time.monotonic() < began + PATIENCE and board.process.poll() is None:
            time.sleep(1)
            try:
                board.command(f"screendump {screen.name}", 60)
            except (OSError, FileNotFoundError):
                continue
            shown = read_ppm(screen) if screen.exists() else None
            if shown and shown[:2] == (640, 480) and wanted[seen](shown[2]):
                seen += 1
                note(f"{name}: {time.monotonic() - began:.0f} s of this machine's time")
    finally:
        board.close(0)
    check(card.hashes() == before, f"{name}: the card's partition and the root are untouched")
    return seen


def keeps(card, style):
    """Whether the settings with this style are on the state partition."""
    return f'name = "{style}"'.encode() in card.read(2)


def main():
    arguments = argparse.ArgumentParser(description="The card image on an emulated board.")
    arguments.add_argument("--host", type=Path, default=ROOT / "target" / "release" / "vernissage",
                           help="the program for this machine, to draw what must be shown")
    arguments.add_argument("--dir", type=Path, default=ROOT / "target" / "image")
    arguments.add_argument("--image", type=Path, help="default DIR/visor.img")
    chosen = arguments.parse_args()
    folder, host = chosen.dir.resolve(), chosen.host.resolve()
    card = Card((chosen.image or folder / "visor.img").resolve(), folder / "try.img")
    if not check(len(card.parts) == 3, f"card: {len(card.parts)} partitions"):
        return 1
    first, second = rendered(host, folder, "plain"), rendered(host, folder, "sketch-like")
    if not check(bool(first and second) and first != second, "pictures: drawn by the program here"):
        return 1
    os.chdir(folder)

    shows = lambda picture: lambda pixels: pixels == picture
    card.write_settings(VISOR.format(style="plain"))
    check(boot(card, folder, "first", [shows(first)]) == 1, "first: the screen shows what the card says")
    card.write_settings(VISOR.format(style="sketch-like"))
    # the cut may come as soon as they are kept
    kept = lambda pixels: pixels == second and keeps(card, "sketch-like")
    check(boot(card, folder, "changed", [kept]) == 1, "changed: other settings are shown, and kept")
    card.write_settings(VISOR.format(style="plain").replace("noise", "nois"))
    seen = boot(card, folder, "mistake", [is_slate, shows(second)])
    check(seen == 2, f"mistake: said on the screen, then what was good last is shown ({seen} of 2 seen)")
    card.write_settings(VISOR.format(style="plain"))
    card.spoil_state()
    check(boot(card, folder, "worn", [shows(first)]) == 1, "worn: a spoilt state partition changes nothing")
    card.write_settings(None)
    check(boot(card, folder, "empty", [is_slate]) == 1, "empty: the screen says that there are no settings")
    card.path.unlink()
    return verdict("image")


if __name__ == "__main__":
    sys.exit(main())
