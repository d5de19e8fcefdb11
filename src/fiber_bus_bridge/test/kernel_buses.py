# SPDX-License-Identifier: Apache-2.0
"""A mock of the kernel's I2C adapters, by umockdev, with simulated robots on them.

It works only inside `umockdev-wrapper`, which redirects /dev/i2c-N and its ioctls to the mock.
"""

import errno
import struct
import sys
import threading

import numpy as np

from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.bus.linux import LinuxBuses
from fiber_bus_bridge.simulation import SimulatedBuses
from fiber_bus_bridge.wire import Addresses, Frames

DEBIAN = "/usr/lib/python3/dist-packages"  # folder of gi for Debian's own Python
I2C_FUNCS, I2C_RDWR = 0x0705, 0x0707
READ, TEN_BIT = 0x01, 0x10
ERRNO = {
    Ack.NO_ADDRESS: errno.ENXIO,
    Ack.REFUSED: errno.EREMOTEIO,
    Ack.LOST: errno.EAGAIN,
    Ack.STUCK: errno.EBUSY,
    Ack.TIMED_OUT: errno.ETIMEDOUT,
    Ack.NOT_SENT: errno.EBUSY,
}


def umockdev():
    """Return the modules of umockdev and GLib, None if they are not installed."""
    sys.path.append(DEBIAN)
    try:
        import gi

        gi.require_version("UMockdev", "1.0")
        from gi.repository import GLib, UMockdev
    except (ImportError, ValueError):
        return None
    finally:
        sys.path.remove(DEBIAN)
    return UMockdev, GLib


class Kernel:
    """Mock devices /dev/i2c-N for simulated buses.

    Args:
        simulated: the buses.
        clock: returns the time of the buses [s]; by default it advances with their traffic.
    """

    def __init__(self, simulated: SimulatedBuses, clock=lambda: 0.0):
        mock, glib = umockdev()
        self.simulated, self.now_s, self.calls, self._clock = simulated, 0.0, [], clock
        self._testbed, self._bases, self.devices = mock.Testbed.new(), [], {}
        for bus in np.unique(simulated.positioners.bus).tolist():
            self.devices[bus] = f"/dev/i2c-{bus}"
            self._testbed.add_from_string(
                f"P: /devices/fake/i2c-{bus}\nN: i2c-{bus}\nE: DEVNAME=/dev/i2c-{bus}\n"
                f"E: SUBSYSTEM=i2c-dev\nE: MAJOR=89\nE: MINOR={bus}\nA: dev=89:{bus}\\n\n"
            )
            base = mock.IoctlBase()
            base.connect("handle-ioctl", self._handle, bus)
            self._testbed.attach_ioctl(self.devices[bus], base)
            self._bases.append(base)
        self._loop = glib.MainLoop()
        self._server = threading.Thread(target=self._loop.run, daemon=True)
        # A node that is made while the loop opens its sockets has been seen to abort.
        running = threading.Event()
        glib.idle_add(running.set)
        self._server.start()
        running.wait()

    def close(self):
        self._loop.quit()
        self._server.join()

    def _handle(self, _, client, bus):
        request, argument = client.get_request() & 0xFFFFFFFF, client.get_arg()
        if request == I2C_FUNCS:
            argument.resolve(0, 8).update(0, struct.pack("<Q", 0x0FFF_FFFF))
            client.complete(0, 0)
        elif request == I2C_RDWR:
            client.complete(*self._transact(argument, bus))
        else:
            return False
        return True

    def _transact(self, argument, bus):
        top = argument.resolve(0, 16)
        count = struct.unpack("<QI4x", top.retrieve())[1]
        table = top.resolve(0, 16 * count)
        heads = [struct.unpack_from("<HHH", table.retrieve(), 16 * k) for k in range(count)]
        self.calls.append(count)
        k = 0
        while k < count:
            address, flags, length = heads[k]
            payload, into = b"", None
            if not flags & READ:
                payload = table.resolve(16 * k + 8, length).retrieve() if length else b""
                follows = k + 1 < count and heads[k + 1][0] == address and heads[k + 1][1] & READ
                k += bool(follows)
            if heads[k][1] & READ:
                into = table.resolve(16 * k + 8, heads[k][2])
            ack, data = self._message(bus, address, bool(flags & TEN_BIT), payload, into, heads[k])
            if ack != Ack.OK:
                return -1, ERRNO[ack]
            if into is not None:
                into.update(0, data)
            k += 1
        return count, 0

    def _message(self, bus, address, ten_bit, payload, into, head):
        to = Addresses([bus], [address], [ten_bit])
        read = 0 if into is None else head[2]
        frame = Frames.from_bytes(to, [payload])
        self.now_s = max(self.now_s, self._clock())
        replies = self.simulated.transfer(frame, read, self.now_s)
        self.now_s = max(self.now_s, float(replies.end_s[0]))
        return Ack(int(replies.ack[0])), replies.data.tobytes()


class KernelBuses(LinuxBuses):
    """The real backend on mock devices; its time is that of the simulated buses."""

    def __init__(self, simulated: SimulatedBuses):
        self._kernel = Kernel(simulated)
        super().__init__(self._kernel.devices, clock=lambda: self._kernel.now_s, wait=self._pass)

    @property
    def calls(self):
        """Number of messages in each call of the kernel."""
        return self._kernel.calls

    def close(self):
        super().close()
        self._kernel.close()

    def _pass(self, seconds):
        self._kernel.now_s += seconds
