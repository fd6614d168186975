"""A line between driver and controller that misbehaves: it cuts, drops, flips, doubles, invents, is mute or deaf.

It sits around any transport, so the driver, its serial port and the controller are those of a sound line.
"""

import random

NOISE = bytes(range(1, 256))


class FaultyLine:
    """A `Transport` around another. Faults begin when they are asked for and last until `repair`."""

    def __init__(self, inner, seed=0):
        self.inner = inner
        self.random = random.Random(seed)
        self.rest = b""
        self.on_bytes = None
        self.repair()

    name = property(lambda self: self.inner.name)
    log = property(lambda self: self.inner.log)
    is_open = property(lambda self: self.inner.is_open)
    is_in_step = property(lambda self: self.inner.is_in_step)

    def open(self, on_bytes, on_lost):
        self.rest, self.on_bytes = b"", on_bytes
        self.inner.open(self.hear, on_lost)

    def close(self):
        self.inner.close()

    def write(self, data):
        for change in self.to_device:
            data = change(data)
        if data:
            self.inner.write(data)

    def hear(self, data):
        """Whole lines of the controller, changed, to the host."""
        *lines, self.rest = (self.rest + data).split(b"\n")
        for line in lines:
            line += b"\n"
            for change in self.to_host:
                line = change(line)
            if line:
                self.on_bytes(line)

    # Faults

    def repair(self):
        """A sound line again."""
        self.to_host, self.to_device = [], []

    def mute(self):
        """The host hears nothing."""
        self.to_host.append(lambda line: b"")

    def deaf(self):
        """The controller hears nothing."""
        self.to_device.append(lambda data: b"")

    def replace(self, words, by, count=1):
        """The next `count` lines of the controller that hold `words` become `by`."""
        left = [count]

        def change(line):
            if words in line and left[0]:
                left[0] -= 1
                return by(line) if callable(by) else by
            return line

        self.to_host.append(change)

    def flip(self, share, is_to_device=False):
        """One bit of this share of the bytes is turned over."""

        def change(data):
            return bytes(
                byte ^ 1 << self.random.randrange(8) if self.random.random() < share else byte for byte in data
            )

        (self.to_device if is_to_device else self.to_host).append(change)

    def litter(self, share):
        """Rubbish between this share of the bytes that the host hears."""

        def change(line):
            out = bytearray()
            for byte in line:
                out.append(byte)
                if self.random.random() < share:
                    out.append(self.random.choice(NOISE))
            return bytes(out)

        self.to_host.append(change)

    def slice(self):
        """The host hears one byte at a time."""

        def change(line):
            for byte in line[:-1]:
                self.on_bytes(bytes([byte]))
            return line[-1:]

        self.to_host.append(change)

    def say(self, data):
        """What the controller never said."""
        self.on_bytes(data)

    def type(self, data):
        """What this host never sent: a stranger at the controller's other end."""
        self.inner.write(data)


def call_after(clock, delay_s, act):
    """Call `act` once when a clock that tells its listeners has moved on by `delay_s`."""
    due_s = clock.now_s() + delay_s

    def listener(now_s):
        if now_s >= due_s:
            clock.remove_listener(listener)
            act()

    clock.add_listener(listener)


class HandsOnVirtual:
    """What a hand can do to the virtual GRBL, for a rig that has it as `controller`."""

    def true_mm(self):
        return self.controller.position_mm()

    def press_reset(self):
        self.controller.inject("reset", boot_s=0.0)

    def close_switch(self, axis):
        self.controller.inject("limit", axis=axis)

    def open_switch(self, axis):
        self.controller.clear("limit", axis=axis)
