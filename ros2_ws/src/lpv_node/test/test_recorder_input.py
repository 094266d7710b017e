"""Input of the recorder."""

import os
import socket

import pytest

from lpv_node.recorder.input import enlarge_sockets

pytestmark = pytest.mark.ros


def test_given_sockets_when_enlarged_then_they_hold_more_and_stay_open():
    with socket.socket(type=socket.SOCK_DGRAM) as one, socket.socket() as other:
        before = [s.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) for s in (one, other)]
        opened = os.listdir('/proc/self/fd')
        enlarge_sockets()
        assert os.listdir('/proc/self/fd') == opened
        after = [s.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) for s in (one, other)]
    assert after[0] > before[0] and after[1] == before[1]
