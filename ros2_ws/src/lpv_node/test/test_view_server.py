import asyncio
import json
import socket
import time
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager, contextmanager, suppress

import aiohttp
import pytest

from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import PATIENCE
from lpv_node.view.access import Access
from lpv_node.view.model import LiveModel
from lpv_node.view.server import LARGEST_MESSAGE, MOST_CONNECTIONS, ViewServer

TOKEN, MANY = 'a token of this test', MOST_CONNECTIONS * [None]
INJECT = {'type': 'inject', 'id': 5, 'sensor': 'link1_angle', 'kind': 'bias', 'size': 0.3}
ASKED = {
    200: (
        {}, {'Host': 'localhost:{port}'}, {'Host': '[::1]:{port}'},
        {'Origin': 'http://127.0.0.1:{port}'}, {'Host': 'localhost', 'Origin': 'http://localhost'},
        {'Sec-Fetch-Site': 'cross-site', 'Sec-Fetch-Mode': 'navigate'},
    ),
    403: (
        {'Origin': 'http://evil.example'}, {'Origin': 'null'}, {'Origin': 'http://127.0.0.1:1'},
        {'Origin': 'http://127.0.0.1.evil.example'}, {'Host': 'evil.example'}, {'Host': ''},
        {'Host': 'evil.example:{port}'}, {'Host': '127.0.0.1.evil.example'},
        {'Host': 'evil.example', 'Origin': 'http://evil.example'},
        {'Sec-Fetch-Site': 'cross-site', 'Sec-Fetch-Mode': 'no-cors'},
    ),
}  # fmt: skip
"""Headers by the status of the answer."""
HANDSHAKE = b'GET /ws HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n'
HANDSHAKE += b'Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n'


GUARD = 60.0
"""Against what never comes: a loaded machine takes seconds for what is at once [s]."""


def wait(condition):
    deadline = time.monotonic() + GUARD
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.01)


class Served:
    def __init__(self, arm, access, **options):
        self.commands, self.answer, self.model = [], True, LiveModel(arm)
        self.server = ViewServer(access, arm.sensor_names, self._submit, **options)
        (self.port,) = self.server.start([(self.server.application(), '127.0.0.1', 0)])
        self.url = f'http://127.0.0.1:{self.port}'

    def _submit(self, command, reply):
        self.commands.append(command)
        if self.answer:
            reply(True, 'done')
        return self.answer

    def welcome(self):
        wait(lambda: self.server.newcomers)
        self.server.frame({'type': 'frame'})  # not for those that are new
        self.server.welcome(self.model.hello())

    def talk(self, messages, headers=None):
        """Send messages (text or dict), collect as many replies; a close code is the last one."""

        async def conversation():
            received = []
            async with connected(f'{self.url}/ws', headers=headers) as ws:
                for message in messages:
                    await send(ws, json.dumps(message) if isinstance(message, dict) else message)
                while len(received) < len(messages):
                    message = await ws.receive(timeout=GUARD)
                    if message.type != aiohttp.WSMsgType.TEXT:
                        return [*received, ws.close_code]
                    received.append(json.loads(message.data))
            return received

        return asyncio.run(conversation())

    def refusal(self, headers=None):
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            self.talk([INJECT], headers)
        return refused.value.status

    def silent_socket(self):
        """A client that opens a WebSocket and then neither reads nor writes."""
        silent = socket.create_connection(('127.0.0.1', self.port))
        silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        silent.sendall(HANDSHAKE)
        assert b'101' in silent.recv(20)
        return silent


def get(url, **headers):
    async def fetch():
        async with aiohttp.request('GET', url, headers=headers) as response:
            return response.status, response.headers, await response.read()

    return asyncio.run(fetch())


@asynccontextmanager
async def connected(url, **options):
    async with aiohttp.ClientSession() as session, session.ws_connect(url, **options) as ws:
        yield ws


async def send(ws, message):
    await (ws.send_bytes(message) if isinstance(message, bytes) else ws.send_str(message))


async def follow(served, count=1):
    """First messages of new clients; they get them, and then the next frames."""
    async with AsyncExitStack() as stack:
        clients, hellos = [], []
        for _ in range(count):
            clients.append(await stack.enter_async_context(connected(f'{served.url}/ws')))
            await asyncio.to_thread(served.welcome)
            hellos.append(await clients[-1].receive_json(timeout=GUARD))
        for ws in 2 * clients:
            served.server.frame({'type': 'frame'})
            assert await ws.receive_json(timeout=GUARD) == {'type': 'frame'}
    return hellos


@contextmanager
def serve(arm, access=None, **options):
    served = Served(arm, access or Access('127.0.0.1'), **options)
    try:
        yield served
    finally:
        served.server.stop()


@pytest.fixture
def served(paper_arm):
    with serve(paper_arm) as served:
        yield served


def test_given_the_page_when_fetched_then_all_of_it_comes_from_here_with_strict_headers(served):
    for path in ('/nothing', '/../access.py', '/static/view.js'):
        status, headers, _ = get(served.url + path)
        assert status == 404 and 'Content-Security-Policy' in headers
    scripts = [f'{name}.js' for name in ('view', 'arm', 'chart', 'link', 'panels', 'theme')]
    for path in ('', 'view.css', 'icon.svg', *scripts):
        status, headers, body = get(f'{served.url}/{path}')
        assert status == 200 and "default-src 'none'" in headers['Content-Security-Policy']
        assert 'unsafe' not in headers['Content-Security-Policy']
        assert headers['Cache-Control'] == 'no-store'
        assert headers['X-Content-Type-Options'] == 'nosniff'
        for elsewhere in (b'http://', b'https://', b'src="//'):
            assert elsewhere not in body.replace(b'http://www.w3.org/2000/svg', b'')


@pytest.mark.parametrize('status', ASKED)
def test_given_another_origin_or_host_when_asked_then_access_is_refused(served, status):
    for given in ASKED[status]:
        headers = {k: v.replace('{port}', str(served.port)) for k, v in given.items()}
        assert get(served.url, **headers)[0] == status, headers
        if status == 200:
            assert served.talk([{'type': 'reset', 'id': 1}], headers)[0]['ok'], 'without a token'
        else:
            assert served.refusal(headers) == 403, headers
    assert len(served.commands) == len(ASKED[200]) * (status == 200)


def test_given_another_address_when_a_button_is_pressed_then_it_takes_the_token(paper_arm):
    with serve(paper_arm, Access('0.0.0.0', TOKEN)) as served:
        assert get(served.url)[0] == 200
        tokens = [{'type': 'token', 'token': token} for token in ('\ud800', TOKEN)]
        refused, wrong, granted, done = served.talk([INJECT, *tokens, INJECT])
        assert not refused['ok'] and 'token' in refused['message']
        assert not wrong['ok'] and granted['ok'] and done['ok'] and len(served.commands) == 1
        # The permission is the connection's, not the server's.
        assert not served.talk([INJECT])[0]['ok'] and TOKEN.encode() not in get(served.url)[2]
        start = time.monotonic()
        *replies, end = served.talk([{'type': 'token', 'token': str(k)} for k in range(8)])
        assert time.monotonic() - start > 2.0
        assert [r['ok'] for r in replies] in ([False] * 4, [False] * 5)
        assert isinstance(end, int), 'the connection ends'


def test_given_no_token_when_bound_elsewhere_then_a_random_one_is_made():
    first, second = Access('0.0.0.0'), Access('192.0.2.7')
    assert len(first.token) >= 20 and first.token != second.token and first.accepts(first.token)
    wrong = '', second.token, first.token + 'x', 'é', '\ud800'
    assert [token for token in wrong if first.accepts(token)] == []
    assert {Access(a).token for a in ('127.0.0.1', '127.3.4.5', '::1', 'localhost')} == {''}
    assert Access('127.0.0.1', TOKEN).token == TOKEN
    for address in ('', 'example.org', '1.2.3'):
        pytest.raises(ConfigError, Access, address).match('address')
    pytest.raises(ConfigError, Access, '0.0.0.0', 'short').match('token')


def test_given_nonsense_when_sent_then_each_message_gets_an_error_and_the_server_goes_on(served):
    nonsense = ['', '{', '[' * 4000, 'NaN', b'\x00\xff', '{"type": "inject"}', '{"size": 1e300}']
    done = {'type': 'reply', 'id': 5, 'command': 'inject', 'ok': True, 'message': 'done'}
    *replies, last = served.talk([*nonsense, INJECT])
    assert [r['type'] for r in replies] == ['error'] * len(nonsense) and last == done
    assert served.commands[0].fields['size'] == 0.3
    assert served.talk([{**INJECT, 'pad': 'x' * LARGEST_MESSAGE}]) == [1009]
    flood = served.talk([INJECT] * 60)
    assert {'type': 'error', 'message': 'too many messages'} in flood
    assert isinstance(flood[-1], int), 'the connection ends'
    assert len(served.commands) <= 35 and served.talk([INJECT]) == [done]
    served.answer = False
    assert 'busy' in served.talk([INJECT])[0]['message']


def test_given_a_client_that_reads_nothing_when_frames_are_sent_then_nobody_waits_for_it(served):
    with served.silent_socket():
        served.welcome()
        big = {**served.model.frame(0.0), 'pad': 'x' * 100_000}
        (client,) = served.server.clients
        stuck = 0
        for _ in range(600):
            start = time.monotonic()
            served.server.frame(big)
            assert time.monotonic() - start < PATIENCE  # a client has twice that time
            time.sleep(0.005)
            stuck = stuck + 1 if client._frame else 0
            if stuck > 40:
                break
        assert stuck > 40, 'the client took everything'
        assert served.talk([INJECT])[0]['ok'], 'others are served meanwhile'
        assert client._waiting.qsize() <= 1, 'frames replace each other, they do not queue'


def test_given_a_port_that_is_taken_when_started_then_the_error_names_it(served):
    other = ViewServer(Access('127.0.0.1'), (), lambda *_: True)
    with pytest.raises(ConfigError, match=f'port {served.port}'):
        other.start([(other.application(), '127.0.0.1', served.port)])
    other.stop()
    with served.silent_socket():
        for _ in range(2):
            served.server.stop()
        served.server.frame({})


def test_given_silent_sockets_in_all_places_when_time_passes_then_others_get_in(paper_arm):
    with serve(paper_arm, max_clients=3, heartbeat=0.4) as served, ExitStack() as silent:
        for _ in range(3):
            silent.enter_context(served.silent_socket())
        assert served.refusal() == 503
        wait(lambda: not served.server.clients)
        assert served.talk([INJECT])[0]['ok']


def test_given_more_connections_than_there_is_room_when_silent_then_they_are_closed(paper_arm):
    with serve(paper_arm, patience=0.5) as served, ExitStack() as idle:
        made = [socket.create_connection(('127.0.0.1', served.port)) for _ in 2 * MANY]
        for one in map(idle.enter_context, made):  # none waits for ever
            one.settimeout(60.0)
            with suppress(ConnectionResetError):
                assert one.recv(1) == b''
        assert get(served.url)[0] == 200


def test_given_idle_connections_in_all_places_when_others_ask_then_they_are_served(paper_arm):
    with serve(paper_arm, patience=GUARD) as served, ExitStack() as idle:
        idle.enter_context(served.silent_socket())  # a page that is open stays so
        for _ in 3 * MANY:
            idle.enter_context(socket.create_connection(('127.0.0.1', served.port)))
        assert get(served.url)[0] == 200
        assert served.talk([INJECT])[0]['ok']
        wait(lambda: len(served.server.clients) == 1)
        assert [client.lost for client in served.server.clients] == [False]
