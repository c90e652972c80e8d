#!/usr/bin/env python3
"""A button board on a pseudo terminal, written from the text of VBP/1 alone: 3 buttons, 1 encoder.

    board_simulator.py LINK

LINK becomes a symbolic link to the terminal that a visor opens. Commands come on stdin, a line each:
    down N, up N            an edge of button N
    deaf MS                 all that the visor says is lost for so long
    mute MS                 all that the board says is lost for so long
    type TEXT               a line of console text
    raw HEX                 bytes as they are
    send TEXT               a message, as a show controller's
    unplug, plug            the terminal goes away, and comes back as another one
    reboot                  the board starts again: clock and numbers from 0, nothing pressed
    quit
What happens goes to stdout, a line each, begun with the simulator's time in ms:
    tx BODY, rx BODY        checked messages
    text LINE               a comment line
    bad LINE                something that is neither
"""
import os
import select
import sys
import time
import tty

RESENDS = (50, 100, 200)


def crc16(body):
    crc = 0xFFFF
    for byte in body:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


assert crc16(b"123456789") == 0x29B1


class Board:
    def __init__(self, link):
        self.link = link
        self.start = time.monotonic()
        self.master = None
        self.deaf = self.mute = 0
        self.boot()

    def now(self):
        return int((time.monotonic() - self.start) * 1000)

    def say(self, what, line):
        print(self.now(), what, line, flush=True)

    def boot(self):
        self.zero = self.now()
        self.seq = 0
        self.pressed = 0
        self.linked = False
        self.unacknowledged = {}
        self.state_due = 0
        self.line = b""

    def plug(self):
        self.master, slave = os.openpty()
        tty.setraw(self.master)
        tty.setraw(slave)
        os.set_blocking(self.master, False)
        new = self.link + ".new"
        os.symlink(os.ttyname(slave), new)
        os.rename(new, self.link)
        # ours is held until the visor has opened its own: a terminal nobody has open reads as hung up
        self.slave = slave
        self.line = b""
        self.linked = False

    def unplug(self):
        os.close(self.slave)
        os.close(self.master)
        self.master = None
        self.linked = False
        self.unacknowledged = {}

    def write(self, data):
        if self.master is not None and self.now() >= self.mute:
            try:
                os.write(self.master, data)
            except BlockingIOError:
                pass

    def transmit(self, body):
        self.say("tx", body)
        self.write(b"$%s*%04X\n" % (body.encode(), crc16(body.encode())))

    def send(self, text):
        seq = self.seq
        self.seq = (self.seq + 1) % 256
        body = "%02X %s" % (seq, text)
        self.transmit(body)
        return seq, body

    def clock(self):
        return (self.now() - self.zero) % 2**32

    def state(self):
        self.send("STATE %X 0 %d" % (self.pressed, self.clock()))
        self.state_due = self.now() + 1000

    def edge(self, number, down):
        bit = 1 << (number - 1)
        self.pressed = self.pressed | bit if down else self.pressed & ~bit
        if self.linked:
            seq, body = self.send("BTN %d %s %d" % (number, "D" if down else "U", self.clock()))
            self.unacknowledged[seq] = (body, self.now() + RESENDS[0], 0)
            self.state()

    def heard(self, body):
        words = body.split(" ")
        if words[1] == "HI?":
            self.linked = False
            if int(words[2]) <= 1 <= int(words[3]):
                self.send("HELLO 1 5F3A01C2 1.4.0 3 1 0003")
        elif words[1] == "OK":
            self.linked = True
            self.state()
        elif words[1] == "ACK":
            self.unacknowledged.pop(int(words[2], 16), None)

    def received(self, line):
        line = line.rstrip(b"\r")
        if line.startswith(b"#"):
            self.say("text", line.decode())
            return
        body, star, crc = line[1:].partition(b"*")
        if line.startswith(b"$") and star and b"%04X" % crc16(body) == crc and len(line) < 96:
            self.say("rx", body.decode())
            self.heard(body.decode())
        else:
            self.say("bad", repr(line))

    def read(self):
        try:
            data = os.read(self.master, 4096)
        except (BlockingIOError, OSError):
            return
        if self.now() < self.deaf:
            return
        for byte in data:
            if byte == ord("$"):
                self.line = b"$"
            elif byte == ord("\n"):
                line, self.line = self.line, b""
                self.received(line)
            else:
                self.line += bytes([byte])

    def tick(self):
        now = self.now()
        for seq, (body, due, times) in list(self.unacknowledged.items()):
            if now >= due:
                self.transmit(body)
                if times + 1 < len(RESENDS):
                    self.unacknowledged[seq] = (body, now + RESENDS[times + 1], times + 1)
                else:
                    del self.unacknowledged[seq]
        if self.linked and now >= self.state_due:
            self.state()

    def command(self, line):
        word, _, rest = line.strip().partition(" ")
        if word in ("down", "up"):
            self.edge(int(rest), word == "down")
        elif word == "deaf":
            self.deaf = self.now() + int(rest)
        elif word == "mute":
            self.mute = self.now() + int(rest)
        elif word == "type":
            self.write(rest.encode() + b"\n")
        elif word == "raw":
            self.write(bytes.fromhex(rest))
        elif word == "send":
            self.send(rest)
        elif word == "unplug":
            self.unplug()
        elif word == "plug":
            self.plug()
        elif word == "reboot":
            self.boot()
            self.send("HELLO 1 5F3A01C2 1.4.0 3 1 0003")
        elif word == "quit":
            sys.exit(0)
        else:
            sys.exit("unknown command: " + line)


def main():
    board = Board(sys.argv[1])
    board.plug()
    board.say("ready", board.link)
    commands = b""
    while True:
        inputs = [0] if board.master is None else [0, board.master]
        ready, _, _ = select.select(inputs, [], [], 0.005)
        if 0 in ready:
            data = os.read(0, 4096)
            if not data:
                return
            commands += data
            while b"\n" in commands:
                line, commands = commands.split(b"\n", 1)
                board.command(line.decode())
        if board.master in ready:
            board.read()
        board.tick()


main()
