import asyncio
import os
import re
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from types import SimpleNamespace

import aiohttp
import numpy as np
import pytest
import ros
import yaml
from places import BRINGUP
from test_view_foxglove import Viewer, connect, decode
from visualization_msgs.msg import MarkerArray

from lpv_msgs.srv import ClearFaults
from lpv_node.view.commands import Command
from lpv_node.view.requests import Requests

pytestmark = pytest.mark.ros
ARM = f'arm_file:={BRINGUP / "arms" / "paper.yaml"}'
GAINS = BRINGUP / 'gains' / 'paper.yaml'


class View:
    """A view that was started on a graph: what it printed, address of its page."""

    def __init__(self, graph, folder, *parameters):
        self._graph, self._log = graph, folder / 'view.log'
        graph.start('view', ros.command('view', ARM, *parameters))
        self.page = self.find(r'page: (http://\S+)')

    @property
    def log(self):
        return self._log.read_text() if self._log.exists() else ''

    def find(self, pattern):
        deadline = time.monotonic() + 60.0
        while not (found := re.search(pattern, self.log)):
            assert time.monotonic() < deadline, self.log
            self._graph.check()
            time.sleep(0.05)
        return found.group(1)


def to_and_fro(folder):
    """A scenario on a line, for longer than any test lasts."""
    points = [{'t': 10 * k + 0.1, 'x': 0.8451 * (-1) ** (k + 1), 'y': 1.5893} for k in range(100)]
    data = {'name': 'to_and_fro', 'duration': 1000.0, 'path': {'waypoints': points}}
    (folder / 'scenario.yaml').write_text(yaml.safe_dump(data))
    return f'scenario_file:={folder}/scenario.yaml'


def free_port():
    """A port that nothing listens on, and that no other process is given by asking for any."""
    first = 10_000 + os.getpid() % 10_000  # below those that systems hand out
    for port in range(first, first + 1000):
        with suppress(OSError), socket.create_server(('127.0.0.1', port)):
            return port
    raise AssertionError('no free port')


@pytest.fixture(scope='module')
def live(tmp_path_factory):
    """One graph for all tests that look on; the view is there first, and must not start it.

    In lockstep, which no load of the machine disturbs, publishers wait for their readers.  Were the
    view taken for one of them, the first sample would be lost, and nothing would ever move.
    """
    folder, domain = tmp_path_factory.mktemp('live'), ros.next_domain()
    scenario = to_and_fro(folder)
    with ros.graph(folder, domain) as graph:
        view = View(graph, folder, scenario, 'port:=0', f'foxglove_port:={free_port()}')
        view.domain = domain
        view.foxglove = int(view.find(r'Foxglove: ws://127\.0\.0\.1:(\d+)'))

        def start(name, *parameters, files=()):
            graph.start(name, ros.command(name, ARM, 'lockstep:=true', *parameters, files=files))

        start('simulator', scenario)
        with ros.client(domain) as client:
            service = client.node.create_client(ClearFaults, 'arm_sim/clear_faults')
            assert client.wait(service.service_is_ready, 60.0)
            client.wait(lambda: False, 1.0)
            assert 'lockstep, ' not in (folder / 'simulator.log').read_text(), 'not for the view'
            start('uio', files=[GAINS])
            start('tracker', scenario, files=[GAINS])
            # Not by an estimate: this client would be one of its readers.  The first run compiles.
            arrays = client.listen(MarkerArray, 'arm_markers', 10)
            assert client.wait(lambda: 'estimated' in {m.ns for a in arrays for m in a.markers})
        yield view
        ros.end(graph)
    assert 'Traceback' not in view.log


@pytest.fixture
def page(live, browser):
    """The page; it must neither complain nor load anything from elsewhere."""
    complaints, asked = [], []
    tab, bad = browser.new_page(), ('error', 'warning')
    tab.set_viewport_size({'width': 1280, 'height': 900})
    tab.on('console', lambda m: complaints.append(m.text) if m.type in bad else None)
    tab.on('pageerror', lambda error: complaints.append(str(error)))
    tab.on('request', lambda request: asked.append(request.url))
    tab.goto(live.page)
    yield tab
    tab.close()
    assert complaints == [] and [url for url in asked if not url.startswith(live.page)] == []


def picture(page):
    return page.evaluate("document.getElementById('arm').toDataURL()")


def until(page, condition, timeout=20.0):
    """Wait for a condition; Playwright's own way is what the page's security policy forbids."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, page.inner_text('body')
        page.wait_for_timeout(50)


def test_given_a_fault_when_injected_from_the_page_then_its_alarm_comes_and_goes(live, page):
    until(page, lambda: page.text_content('#mode') == 'observing', 60.0)
    assert page.inner_text('#arm-name') == 'paper'
    first = picture(page)
    until(page, lambda: picture(page) != first)
    page.wait_for_selector('#verdict.ok', timeout=20_000)
    page.select_option('#sensor', 'link2_angle')
    page.fill('#size', '0.4')
    page.click('#inject')
    page.wait_for_selector('tr.open[data-sensor="link2_angle"]', timeout=60_000)
    assert 'bias on link2_angle' in page.inner_text('#reply')
    page.wait_for_selector('#verdict.error')
    assert page.inner_text('#verdict-head') == 'link2_angle is faulty'
    reading = page.locator('#sensor-1 .reading b')
    until(page, lambda: abs(float(reading.text_content()[1:6]) - 0.4) < 0.1)
    assert page.inner_text('#sensor-1 .pill') == '✕ faulty'
    row = page.locator('tr[data-sensor="link2_angle"]').first
    until(page, lambda: 'bias' in row.inner_text())
    page.click('#clear')
    page.wait_for_selector('tr.open', state='detached', timeout=60_000)
    page.wait_for_selector('#verdict.ok')
    assert '1 faults cleared' in page.inner_text('#reply')
    assert 'over' in row.inner_text() and 'bias' in row.inner_text()


def test_given_a_phone_when_the_page_is_opened_then_nothing_is_wider_than_the_screen(live, page):
    page.set_viewport_size({'width': 360, 'height': 740})
    page.wait_for_selector('#clock:not([hidden])', timeout=60_000)
    assert page.evaluate('document.documentElement.scrollWidth') <= 360
    for theme in ('dark', 'light'):
        page.emulate_media(color_scheme=theme)
        until(page, lambda t=theme: page.get_attribute('html', 'data-theme') == t)
    page.select_option('#kind', 'stuck')
    assert not page.is_visible('#size')
    page.select_option('#kind', 'drift')
    assert page.is_visible('#size') and page.is_visible('#rate')
    for name in ('inject', 'clear', 'reset', 'theme'):
        box = page.locator(f'#{name}').bounding_box()
        assert box['height'] >= 40, f'{name} is too small for a finger'


def test_given_a_page_when_the_connection_breaks_then_it_says_so_and_comes_back(live, page):
    page.wait_for_selector('#clock:not([hidden])', timeout=60_000)
    # A WebSocket that is closed under the page, as by a node that ends.
    page.evaluate("""() => {
      const send = WebSocket.prototype.send;
      WebSocket.prototype.send = function (data) { window.cut = () => this.close();
        WebSocket.prototype.send = send; send.call(this, data); };
    }""")
    page.click('#reset')
    page.evaluate('window.cut()')
    until(page, lambda: page.text_content('#connection') != 'connected')
    until(page, lambda: page.text_content('#connection') == 'connected')
    clock = page.text_content('#clock')
    until(page, lambda: page.text_content('#clock') != clock)


def test_given_a_running_graph_when_foxglove_connects_then_it_sees_the_topics_and_their_data(live):
    names = 'joint_states state_estimate fault_estimate torque_command ground_truth reference'
    names += ' arm_markers fault_band'
    wanted = {f'/lpv/{name}' for name in names.split()} | {'/diagnostics'}

    async def listen():
        seen = {}
        async with connect(live.foxglove) as ws:
            viewer = Viewer(ws)
            await viewer.start(10)
            deadline = time.monotonic() + 60.0
            while not wanted <= set(seen) and time.monotonic() < deadline:
                topic, *seen[topic] = await viewer.next()  # stamp, data
            return {c['topic']: c for c in viewer.channels.values()}, seen

    # In a thread of its own: the browser's driver keeps an event loop in this one.
    with ThreadPoolExecutor(1) as thread:
        channels, seen = thread.submit(lambda: asyncio.run(listen())).result()
    assert wanted <= set(seen), wanted - set(seen)
    stamp, data = seen['/lpv/state_estimate']
    state = decode(channels['/lpv/state_estimate'], data)
    assert stamp == state.header.stamp.sec * 10**9 + state.header.stamp.nanosec
    assert np.isfinite(state.position).all()


def test_given_a_running_graph_when_rviz_listens_then_it_gets_the_arms(live, paper_arm):
    with ros.client(live.domain) as client:
        markers = client.listen(MarkerArray, 'arm_markers', 10)
        assert client.wait(lambda: any(len(m.markers) == 6 for m in markers), 60.0)
    lines = {m.ns: m.points for array in markers for m in array.markers if m.id == 0}
    tip = lines['true'][-1]
    assert tip.z == pytest.approx(1.5893, abs=0.05), 'the path is a line at this height'
    for name in ('true', 'estimated', 'measured'):
        *_, elbow, other = lines[name]
        assert np.hypot(elbow.x, elbow.z) == pytest.approx(paper_arm.joints[1].position[0])
        assert np.hypot(other.x - tip.x, other.z - tip.z) < 0.1


def test_given_a_view_for_others_when_opened_then_buttons_need_the_token(live, tmp_path, request):
    with ros.graph(tmp_path, live.domain) as graph:
        shown = View(graph, tmp_path, 'address:=0.0.0.0', 'port:=0', 'foxglove_port:=0')
        token = shown.find(r'need the token (\S+)')
        assert len(token) >= 20 and shown.find(r'/#token=(\S+)') == token
        assert shown.log.count('need the token') == 1
        page = request.getfixturevalue('browser').new_page()
        # Look without it, fail without it, type it, then come by the link that carries it.
        address = f'http://127.0.0.1:{shown.page.rsplit(":", 1)[1]}'
        reply = page.locator('#reply')
        page.goto(address)
        page.wait_for_selector('#clock:not([hidden])', timeout=20_000)
        assert page.is_visible('#token-form')
        until(page, lambda: page.is_enabled('#inject'))
        page.click('#clear')
        until(page, lambda: 'the token is needed' in reply.inner_text())
        page.fill('#token', 'a wrong one')
        page.click('#token-form button')
        until(page, lambda: 'not the token' in reply.inner_text())
        page.fill('#token', token)
        page.click('#token-form button')
        until(page, lambda: 'accepted' in reply.inner_text())
        assert not page.is_visible('#token-form')
        page.click('#clear')
        until(page, lambda: 'faults cleared' in reply.inner_text())
        page.goto('about:blank')
        page.goto(f'{address}#token={token}')
        until(page, lambda: 'accepted' in reply.inner_text())
        assert page.url == address, 'the token is gone from the address bar'
        assert not page.is_visible('#token-form')
        page.close()
        assert graph.stop() == {'view': 0}


def test_given_a_view_that_is_not_active_when_a_button_is_pressed_then_it_is_refused(tmp_path):
    domain = ros.next_domain()

    async def press(page):
        async with aiohttp.ClientSession() as session, session.ws_connect(f'{page}ws') as ws:
            await ws.send_json({'type': 'reset', 'id': 1})
            while 'message' not in (answer := await asyncio.wait_for(ws.receive_json(), 20.0)):
                pass
        return answer['message']

    with ros.graph(tmp_path, domain) as graph, ros.client(domain) as client:
        shown = View(graph, tmp_path, 'port:=0', 'foxglove_port:=0')
        # Deactivate, activate.
        for step, told in ((4, 'not active'), (3, 'uio/reset is not there')):
            assert ros.change_state(client, 'view', step)
            assert client.wait(lambda t=told: t in asyncio.run(press(shown.page)), 60.0)
        ros.end(graph)


def test_given_a_waiting_command_when_the_view_is_deactivated_then_it_is_dropped():
    said = []
    requests = Requests(SimpleNamespace(create_client=lambda *_: None))
    requests.open(True)
    assert requests.submit(Command('reset'), lambda *reply: said.append(reply)) and not said
    requests.open(False)
    assert [success for success, _ in said] == [False] and 'not active' in said[0][1]
    requests.work()  # with nothing to do
