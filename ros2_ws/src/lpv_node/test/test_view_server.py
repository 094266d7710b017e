"""The web server of the live view: who gets in, what is refused, and that nothing stops it."""

import asyncio
import json
import socket
import time
from contextlib import contextmanager

import pytest

aiohttp = pytest.importorskip('aiohttp')
pytest.importorskip('lpv_node.view', reason='the workspace is not built')

from lpv.core.support.errors import ConfigError  # noqa: E402
from lpv_node.view.access import Access  # noqa: E402
from lpv_node.view.model import LiveModel  # noqa: E402
from lpv_node.view.server import LARGEST_MESSAGE, ViewServer  # noqa: E402

TOKEN = 'a token of this test'
INJECT = {'type': 'inject', 'id': 5, 'sensor': 'link1_angle', 'kind': 'bias', 'size': 0.3}
HANDSHAKE = (
    b'GET /ws HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n'
    b'Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n'
)


class Served:
    """A running server, and what was submitted to it."""

    def __init__(self, arm, access, answer=True, **options):
        self.commands = []
        self.model = LiveModel(arm)

        def submit(command, reply):
            self.commands.append(command)
            if answer:
                reply(True, 'done')
            return answer

        self.server = ViewServer(access, arm.sensor_names, submit, **options)
        (self.port,) = self.server.start([(self.server.application(), '127.0.0.1', 0)])
        self.url = f'http://127.0.0.1:{self.port}'

    def welcome(self):
        deadline = time.monotonic() + 5.0
        while not self.server.newcomers and time.monotonic() < deadline:
            time.sleep(0.01)
        self.server.welcome(self.model.hello())


@contextmanager
def serve(arm, access=None, **options):
    served = Served(arm, access or Access('127.0.0.1'), **options)
    try:
        yield served
    finally:
        served.server.stop()


def talk(served, messages, headers=None, replies=None):
    """Send messages (text or dict), collect as many replies; the last is a close code if closed."""

    async def conversation():
        received, url = [], served.url + '/ws'
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(url, headers=headers) as ws,
        ):
            for message in messages:
                message = json.dumps(message) if isinstance(message, dict) else message
                await (ws.send_bytes if isinstance(message, bytes) else ws.send_str)(message)
            while len(received) < (len(messages) if replies is None else replies):
                message = await ws.receive(timeout=10.0)
                if message.type != aiohttp.WSMsgType.TEXT:
                    received.append(ws.close_code)
                    break
                received.append(json.loads(message.data))
        return received

    return asyncio.run(conversation())


def get(served, path='/', **headers):
    async def fetch():
        async with (
            aiohttp.ClientSession() as session,
            session.get(served.url + path, headers=headers) as response,
        ):
            return response.status, response.headers, await response.read()

    return asyncio.run(fetch())


def test_given_the_page_when_fetched_then_all_of_it_comes_from_here_with_strict_headers(paper_arm):
    with serve(paper_arm) as served:
        scripts = [f'{name}.js' for name in ('view', 'arm', 'chart', 'link', 'panels', 'theme')]
        pages = {p: get(served, f'/{p}') for p in ('', 'view.css', 'icon.svg', *scripts)}
        for path in ('/nothing', '/../access.py', '/static/view.js'):
            status, headers, _ = get(served, path)
            assert status == 404 and 'Content-Security-Policy' in headers
    for status, headers, body in pages.values():
        assert status == 200
        assert "default-src 'none'" in headers['Content-Security-Policy']
        assert 'unsafe' not in headers['Content-Security-Policy']
        assert headers['Cache-Control'] == 'no-store'
        assert headers['X-Content-Type-Options'] == 'nosniff'
        for elsewhere in (b'http://', b'https://', b'src="//'):
            assert elsewhere not in body.replace(b'http://www.w3.org/2000/svg', b'')


@pytest.mark.parametrize(
    ('headers', 'status'),
    [
        ({}, 200),
        ({'Host': 'localhost:{port}'}, 200),
        ({'Host': '[::1]:{port}'}, 200),
        ({'Origin': 'http://127.0.0.1:{port}'}, 200),
        ({'Host': 'localhost', 'Origin': 'http://localhost'}, 200),
        ({'Sec-Fetch-Site': 'cross-site', 'Sec-Fetch-Mode': 'navigate'}, 200),
        ({'Origin': 'http://evil.example'}, 403),
        ({'Origin': 'null'}, 403),
        ({'Origin': 'http://127.0.0.1:1'}, 403),
        ({'Origin': 'http://127.0.0.1.evil.example'}, 403),
        ({'Host': 'evil.example'}, 403),
        ({'Host': 'evil.example:{port}'}, 403),
        ({'Host': 'evil.example', 'Origin': 'http://evil.example'}, 403),
        ({'Host': '127.0.0.1.evil.example'}, 403),
        ({'Host': ''}, 403),
        ({'Sec-Fetch-Site': 'cross-site', 'Sec-Fetch-Mode': 'no-cors'}, 403),
    ],
)
def test_given_a_request_when_its_origin_or_host_is_another_then_page_and_socket_are_refused(
    paper_arm, headers, status
):
    with serve(paper_arm) as served:
        headers = {k: v.replace('{port}', str(served.port)) for k, v in headers.items()}
        assert get(served, **headers)[0] == status
        if status == 200:
            assert talk(served, [{'type': 'reset', 'id': 1}], headers)[0]['ok']
        else:
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                talk(served, [INJECT], headers)
            assert refused.value.status == 403
            assert served.commands == []


def test_given_the_loopback_address_when_a_button_is_pressed_then_no_token_is_needed(paper_arm):
    with serve(paper_arm) as served:
        (reply,) = talk(served, [INJECT])
    assert reply == {'type': 'reply', 'id': 5, 'command': 'inject', 'ok': True, 'message': 'done'}
    assert served.commands[0].fields['size'] == 0.3


def test_given_another_address_when_a_button_is_pressed_then_the_token_is_needed_but_not_to_look(
    paper_arm,
):
    access = Access('0.0.0.0', TOKEN)
    with serve(paper_arm, access) as served:
        assert get(served)[0] == 200
        tokens = [{'type': 'token', 'token': token} for token in ('\ud800', TOKEN)]
        refused, wrong, granted, done = talk(served, [INJECT, *tokens, INJECT])
        assert not refused['ok'] and 'token' in refused['message']
        assert not wrong['ok'] and granted['ok'] and done['ok']
        assert len(served.commands) == 1
        # The permission is the connection's, not the server's.
        assert not talk(served, [INJECT])[0]['ok']
        assert TOKEN.encode() not in get(served)[2]


def test_given_wrong_tokens_when_tried_again_and_again_then_the_connection_ends(paper_arm):
    with serve(paper_arm, Access('0.0.0.0', TOKEN)) as served:
        start = time.monotonic()
        replies = talk(served, [{'type': 'token', 'token': str(k)} for k in range(8)])
        assert time.monotonic() - start > 2.0
    assert [r['ok'] for r in replies[:-1]] in ([False] * 4, [False] * 5)
    assert isinstance(replies[-1], int)


def test_given_no_token_when_bound_elsewhere_then_a_random_one_is_made():
    first, second = Access('0.0.0.0'), Access('192.0.2.7')
    assert len(first.token) >= 20 and first.token != second.token
    assert first.accepts(first.token)
    for wrong in ('', second.token, first.token + 'x', 'é', '\ud800'):
        assert not first.accepts(wrong)
    for loopback in ('127.0.0.1', '127.3.4.5', '::1', 'localhost'):
        assert Access(loopback).token == ''
    assert Access('127.0.0.1', TOKEN).token == TOKEN


@pytest.mark.parametrize(
    ('given', 'named'),
    [('', 'address'), ('example.org', 'address'), ('1.2.3', 'address'), ('0.0.0.0 short', 'token')],
)
def test_given_an_address_or_token_that_will_not_do_when_set_up_then_it_is_named(given, named):
    with pytest.raises(ConfigError, match=named):
        Access(*(given.split() or ['']))


def test_given_nonsense_when_sent_then_each_message_gets_an_error_and_the_server_goes_on(paper_arm):
    nonsense = ['', '{', '[' * 4000, 'NaN', b'\x00\xff', '{"type": "inject"}', '{"size": 1e300}']
    with serve(paper_arm) as served:
        replies = talk(served, [*nonsense, INJECT])
        assert [r['type'] for r in replies] == ['error'] * len(nonsense) + ['reply']
        too_large = talk(served, [json.dumps({**INJECT, 'pad': 'x' * LARGEST_MESSAGE})], replies=1)
        assert too_large == [1009]
        flood = talk(served, [INJECT] * 60)
        assert {'type': 'error', 'message': 'too many messages'} in flood
        assert isinstance(flood[-1], int), 'the connection ends'
        assert len(served.commands) <= 35
        assert talk(served, [INJECT])[0]['ok']


def test_given_a_busy_node_when_a_command_comes_then_the_client_is_told(paper_arm):
    with serve(paper_arm, answer=False) as served:
        assert 'busy' in talk(served, [INJECT])[0]['message']


def test_given_clients_when_frames_are_sent_then_all_get_them_after_their_welcome(paper_arm):
    async def listen(url, count):
        async with aiohttp.ClientSession() as session, session.ws_connect(url) as ws:
            return [json.loads((await ws.receive(timeout=10.0)).data) for _ in range(count)]

    async def all_of_them(served):
        listeners = [asyncio.ensure_future(listen(served.url + '/ws', 3)) for _ in range(3)]
        while not all(task.done() for task in listeners):
            if served.server.newcomers:
                served.server.welcome(served.model.hello())
            served.server.frame(served.model.frame(0.0))
            await asyncio.sleep(0.02)
        return [task.result() for task in listeners]

    with serve(paper_arm) as served:
        for received in asyncio.run(all_of_them(served)):
            assert [m['type'] for m in received] == ['hello', 'frame', 'frame']
            assert received[0]['sensors'] == list(paper_arm.sensor_names)
            assert received[0]['token_needed'] is False


def test_given_a_client_that_reads_nothing_when_frames_are_sent_then_nobody_waits_for_it(paper_arm):
    with serve(paper_arm) as served, socket.create_connection(('127.0.0.1', served.port)) as lazy:
        lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        lazy.sendall(HANDSHAKE)
        served.welcome()
        frame = served.model.frame(0.0)
        big = {**frame, 'pad': 'x' * 100_000}
        (client,) = served.server.clients
        waited, stuck = 0.0, 0
        for _ in range(600):
            start = time.monotonic()
            served.server.frame(big)
            waited = max(waited, time.monotonic() - start)
            time.sleep(0.005)
            stuck = stuck + 1 if client._frame is not None else 0
            if stuck > 40:
                break
        assert stuck > 40, 'the client took everything'
        assert waited < 1.0
        assert talk(served, [INJECT])[0]['ok'], 'others are served meanwhile'
        assert not client._waiting, 'frames replace each other, they do not queue'


def test_given_too_many_clients_when_another_comes_then_it_is_refused(paper_arm):
    async def crowd(url):
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(url),
            session.ws_connect(url),
        ):
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                await session.ws_connect(url)
            return refused.value.status

    with serve(paper_arm, max_clients=2) as served:
        assert asyncio.run(crowd(served.url + '/ws')) == 503


def test_given_a_port_that_is_taken_when_started_then_the_error_names_it(paper_arm):
    with serve(paper_arm) as served:
        other = ViewServer(Access('127.0.0.1'), paper_arm.sensor_names, lambda *_: True)
        with pytest.raises(ConfigError, match=f'port {served.port}'):
            other.start([(other.application(), '127.0.0.1', served.port)])
        other.stop()
        served.server.stop()
        served.server.stop()
        served.server.frame({})


def test_given_silent_sockets_in_all_places_when_time_passes_then_others_get_in(paper_arm):
    with serve(paper_arm, max_clients=3, heartbeat=0.4) as served:
        silent = [socket.create_connection(('127.0.0.1', served.port)) for _ in range(3)]
        for one in silent:
            one.sendall(HANDSHAKE)
            assert b'101' in one.recv(20)
        with pytest.raises(aiohttp.WSServerHandshakeError):
            talk(served, [INJECT])
        deadline = time.monotonic() + 60.0
        while served.server.clients and time.monotonic() < deadline:
            time.sleep(0.05)
        assert talk(served, [INJECT])[0]['ok']
        for one in silent:
            one.close()
