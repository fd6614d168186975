import os
import pty
import threading
import tty

import pytest

from fast.hardware.wire.serial import LinkLostError, SerialTransport
from tests.waiting import wait_for


@pytest.fixture
def line():
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(slave)
    if master >= 0:
        os.close(master)


def test_bytes_go_both_ways_and_are_logged(line):
    master, port = line
    heard, lost = [], []
    transport = SerialTransport(port)
    transport.open(heard.append, lost.append)
    transport.write(b"$I\n")
    assert os.read(master, 100) == b"$I\n"
    os.write(master, b"ok\r\n")
    assert wait_for(lambda: b"".join(heard) == b"ok\r\n")
    transport.close()
    transport.close()
    assert lost == []
    said = [(entry.direction, entry.data) for entry in transport.log.entries()]
    assert said == [("note", b"opened"), ("sent", b"$I\n"), ("received", b"ok\r\n"), ("note", b"closed")]
    assert not any("reader" in thread.name for thread in threading.enumerate())


def test_can_be_reopened(line):
    master, port = line
    transport = SerialTransport(port)
    for _ in range(3):
        heard = []
        transport.open(heard.append, heard.append)
        with pytest.raises(LinkLostError, match="open already"):
            transport.open(heard.append, heard.append)
        os.write(master, b"x")
        assert wait_for(lambda heard=heard: heard == [b"x"])
        transport.close()


def test_missing_port_is_one_sentence(tmp_path):
    transport = SerialTransport(str(tmp_path / "none"))
    with pytest.raises(LinkLostError, match="did not open: it does not exist; plug it in"):
        transport.open(lambda data: None, lambda reason: None)
    with pytest.raises(LinkLostError, match="is closed; connect before sending"):
        transport.write(b"?")
    transport.close()


def test_port_in_use_is_refused(line):
    _, port = line
    first, second = SerialTransport(port), SerialTransport(port)
    first.open(lambda data: None, lambda reason: None)
    with pytest.raises(LinkLostError, match="did not open: another program has it; end that program first"):
        second.open(lambda data: None, lambda reason: None)
    first.close()


def test_hang_up_is_reported_once_and_never_raises_in_the_reader():
    master, slave = pty.openpty()
    port = os.ttyname(slave)
    lost = []
    transport = SerialTransport(port)
    transport.open(lambda data: None, lost.append)
    os.close(slave)
    os.close(master)
    assert wait_for(lambda: len(lost) == 1)
    with pytest.raises(LinkLostError, match="took no bytes"):
        transport.write(b"?")
    transport.close()
    assert len(lost) == 1
