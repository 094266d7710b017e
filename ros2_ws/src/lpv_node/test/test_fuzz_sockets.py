import asyncio
import contextlib
import json
import math
import random
import socket

import pytest
from fuzzing import Tally, bounded_memory, cases
from test_view_foxglove import bridge
from test_view_server import aiohttp, connected, follow, send, serve

from lpv.core.simulation.faults import KINDS

pytestmark = pytest.mark.fuzz
_CONNECTIONS, _MESSAGES = 12, 20
VALUES = (
    None, True, -1, 0, 1, 0.5, 1e300, 2**53, 10**400, '', 'x', 'a' * 3000, [], {}, [[]], '\ud800',
    'link1_angle', 'bias', 'NaN', math.nan, math.inf,
)  # fmt: skip
GOOD = (
    {'type': 'inject', 'id': 1, 'sensor': 'link1_angle', 'kind': 'bias', 'size': 0.3},
    {'type': 'clear', 'id': 2, 'sensor': ''}, {'type': 'reset', 'id': 3},
)  # fmt: skip


def hostile(rng):
    """One message: a good one with other values, keys or bytes; or nothing of the kind."""
    kind = rng.randrange(8)
    if kind == 0:
        return rng.randbytes(rng.choice((0, 1, 5, 200, 3000)))
    if kind == 1:
        return rng.choice(('', '{', '[]', '7', '[' * 1500, '{"type": NaN}', '"' * 99, '\x00', '💥'))
    data = dict(rng.choice(GOOD))
    for _ in range(rng.choice((0, 1, 1, 2))):
        data[rng.choice([*data, 'size', 'rate', 'x'])] = rng.choice(VALUES)
    text = json.dumps(data)
    if kind == 2:
        place = rng.randrange(len(text))
        text = text[:place] + rng.choice('{}[]",:0e\\\n') + text[place + 1 :]
    return text


@pytest.fixture(autouse=True)
def log(caplog):
    """What the servers log: never a traceback."""
    yield caplog
    assert 'Traceback' not in caplog.text


async def hostile_page(served, rng, tally):
    """One connection: each message is answered by a reply or an error, or ends it."""
    async with connected(f'{served.url}/ws') as ws:
        for _ in range(_MESSAGES):
            tally.tried += 1
            await send(ws, hostile(rng))
            answer = await ws.receive(timeout=10.0)
            if answer.type != aiohttp.WSMsgType.TEXT:
                tally.refused += 1
                return
            reply = json.loads(answer.data)
            assert reply['message'] and len(reply['message']) < 500, reply
            good = reply['type'] == 'reply' and reply['ok']
            tally.accepted += good
            tally.refused += not good


def test_given_hostile_messages_to_the_page_when_sent_then_each_is_answered(paper_arm):
    tally = Tally()
    with bounded_memory(), serve(paper_arm) as served:
        for seed in cases(_CONNECTIONS):
            asyncio.run(hostile_page(served, random.Random(seed), tally))
        for hello in asyncio.run(follow(served, 3)):
            assert hello['type'] == 'hello' and hello['token_needed'] is False
            assert hello['sensors'] == list(paper_arm.sensor_names)
    print(tally)
    assert tally.refused and tally.accepted
    for command in served.commands:
        fields = command.fields
        assert command.name in ('inject', 'clear', 'reset')
        assert fields.get('sensor', '') in ('', *paper_arm.sensor_names)
        assert fields.get('kind', 'bias') in KINDS
        assert all(abs(fields.get(name, 0.0)) <= 1e6 for name in ('size', 'rate', 'duration'))


REQUESTS = (
    b'', b'\x00' * 100, b'GET / HTTP/9.9\r\n\r\n', b'GET ' + b'/' * 70_000, b'\r\n' * 5000,
    b'GET /ws HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\n\r\n' + b'\xff' * 500,
    b'POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 99999999999\r\n\r\nx',
    b'GET / HTTP/1.1\r\nHost: localhost\r\n' + b'A: b\r\n' * 5000 + b'\r\n',
    b'GET /%00%ff/../../etc/passwd HTTP/1.1\r\nHost: localhost\r\n\r\n',
)  # fmt: skip


def test_given_bytes_that_are_no_request_when_sent_then_the_port_serves_others(paper_arm, log):
    with serve(paper_arm) as served, bridge(paper_arm) as (_, foxglove):
        for seed in cases(60):
            rng = random.Random(seed)
            address, data = ('127.0.0.1', rng.choice((served.port, foxglove))), rng.choice(REQUESTS)
            if rng.random() < 0.5 and data:
                place = rng.randrange(len(data))
                data = data[:place] + rng.randbytes(8) + data[place + 8 :]
            connection, answer = socket.create_connection(address, 5.0), b''
            with connection, contextlib.suppress(ConnectionError):
                connection.sendall(data)
                connection.shutdown(socket.SHUT_WR)
                answer = connection.recv(1 << 16)
            assert not answer or answer.split()[1][:1] in (b'3', b'4', b'5'), answer[:200]
        assert asyncio.run(follow(served))[0]['type'] == 'hello'
    assert len(log.text) < 2000, 'a flood of lines'
