import json
import math
import shutil
import subprocess
from importlib import resources
from pathlib import Path

import pytest
import test_view_model as made
from fault_injection import with_joints
from serial_bags import crane
from test_view_model import RAISED, message, report, state_estimate

from lpv_node.view.model import LiveModel

NODE = shutil.which('node')
pytestmark = pytest.mark.skipif(NODE is None, reason='there is no Node.js')
HEAD, TEXT = ('show', 'verdict-head'), ('show', 'verdict-text')


@pytest.fixture
def show(tmp_path):
    for file in resources.files('lpv_node.view').joinpath('static').iterdir():
        if file.name.endswith('.js'):
            (tmp_path / file.name).write_text(file.read_text().replace("from '/", "from './"))
    (tmp_path / 'package.json').write_text('{"type": "module"}')
    shutil.copy(Path(__file__).with_name('page_stand_in.mjs'), tmp_path)

    def run(*steps):
        done = subprocess.run(
            [NODE, 'page_stand_in.mjs'], input=json.dumps(steps), cwd=tmp_path, text=True,
            capture_output=True,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


@pytest.fixture
def model(paper_arm):
    """Of a planar arm whose second joint slides; nothing is wrong with it."""
    return seen(LiveModel(with_joints(paper_arm, 1, type='prismatic')))


def seen(model, t=1.0, now=0.0, **fields):
    model.take('fault_estimate', made.fault_estimate(t, **fields), now)
    model.take('state_estimate', state_estimate(t), now)
    return model


def take(model, now=0.0, **changes):
    hello = {**model.hello(), 'token_needed': False, **changes}
    return ('open',), ('take', hello), ('take', model.frame(now))


def test_given_a_lost_connection_when_the_page_is_drawn_then_it_gives_no_verdict(show, model):
    model.services = dict.fromkeys(model.services, True)
    lost = (('show', 'connection'), HEAD, ('show', 'inject', 'disabled'))
    answers = show(
        *take(model), HEAD, ('set', 'size', '0.7'), ('close',), ('fire', 'theme', 'click'),
        ('pass', 100), *lost, ('pass', 2000), *take(model), *lost, ('show', 'size', 'value'),
    )  # fmt: skip
    gone = ['connection lost, trying again', 'No connection to the node', True]
    assert answers == ['No sensor fault', *gone, 'connected', 'No sensor fault', False, '0.7']


@pytest.mark.parametrize('opened', [True, False])
def test_given_a_connection_that_dies_when_silent_then_another_is_opened(show, model, opened):
    steps = take(model) if opened else ()
    assert show(*steps, ('sockets',), ('pass', 3000), ('sockets',)) == [1, 1]
    answers = show(*steps, ('pass', 6000), ('sockets',), *take(model), ('sockets',), HEAD)
    assert answers == [2, 2, 'No sensor fault']


def test_given_alarms_when_shown_then_they_say_what_is_wrong_by_how_much_how_sure(show, model):
    first, second = model.hello()['sensors']
    seen(model, 2.0, estimate=(0.0, 0.01234), alarm=(False, True), state=(3, 2))
    for sensor, values in (
        (second, {'size': 0.05, 'confidence': 1.0}),
        (second, {'kind': 'rate_bias', 'size': -0.02, 'confidence': 0.9972}),
        (first, {'kind': 'dropout', 'size': 0.0, 'bound': 0.0, 'confidence': 1.0}),
        ('elsewhere', {'kind': 'noise', 'bound': math.inf, 'confidence': 0.99999}),
    ):
        model.take('fault_alarm', made.alarm(RAISED, 1.01, sensor=sensor, **values), 0.0)
    head, text, table = show(*take(model), HEAD, TEXT, ('show', 'alarms'))
    assert head == f'{second} and {second} (rate) and {first} and elsewhere are faulty'
    assert text.split('; ') == [
        f'{second}: error +0.0123 m (bound 0.1000 m), bias, guaranteed',
        f'{second} (rate): error \N{MINUS SIGN}0.0200 m/s (bound 0.0500 m/s), rate_bias, '
        'confidence 99.7%',
        f'{first}: no readings (dropout), guaranteed',
        'elsewhere: error of unknown size, too much noise, confidence > 99.9%',
    ]
    assert '+0.0500 m 0.0500 m guaranteed' in table
    assert f'{first} dropout \N{EN DASH} \N{EN DASH} guaranteed' in table


def test_given_joints_that_turn_and_slide_when_shown_then_figures_have_their_units(show, model):
    seen(model, 2.0, estimate=(0.1, 0.0123))
    model.take('torque_command', message(2.0, torque=[0.041, 14.7], safe_stop=False), 0.0)
    asked = ('sensor-0', 'sensor-1', 'torque-now', 'size-label')
    second = model.hello()['sensors'][1]
    turning, sliding, torques, label, other = show(
        *take(model), *(('show', one) for one in asked), ('set', 'sensor', second),
        ('fire', 'sensor', 'change'), ('show', 'size-label'),
    )  # fmt: skip
    assert '+0.100 rad ± 0.100, threshold 0.100' in turning
    assert '+0.0123 m ± 0.1000, threshold 0.1000' in sliding
    assert (torques, label, other) == ('+0.04 N m / +14.70 N', 'Size [rad]', 'Size [m]')


def test_given_states_and_errors_without_an_alarm_then_the_verdict_names_them(show, model):
    first, second = model.hello()['sensors']
    seen(model, 2.0, state=(0, 1))
    assert show(*take(model), TEXT) == [f' Suspected, not confirmed: {second}']
    # An alarm that came before this node.
    seen(model, 3.0, state=(2, 0))
    assert show(*take(model), HEAD) == [f'{first} is faulty']
    seen(model, 4.0, state=(0, 0))
    report(model, 0.0, 'camera', message='no frames', arm='camera')
    assert show(*take(model), HEAD) == ['No sensor fault']
    report(model, 0.0, 'load', message='no numbers')
    assert show(*take(model), HEAD, TEXT) == ['A node reports an error', 'load: no numbers']
    report(model, 0.0, 'tracker', message='safe stop: no estimate')
    assert show(*take(model), HEAD) == ['The arm is stopped']
    seen(model, 5.0, now=60.0)  # by then both are silent
    assert show(*take(model, 60.0), HEAD) == ['No sensor fault']


def test_given_a_wild_reading_when_the_arm_is_drawn_then_the_picture_does_not_shrink(show, model):
    frames = []
    for length in (0.1, 1e6, 0.1):
        model.take('joint_states', made.joint_states(2.0, ['joint1', 'joint2'], [1.0, length]), 0.0)
        frames.append(('take', model.frame(0.0)))
    calls = show(*take(model), *frames, ('show', 'arm', 'calls'))[0]
    last = [call for call in calls[-60:] if call[0] in ('moveTo', 'lineTo')]
    heights = [y for _, _, y in last[-12:]]
    assert max(heights) - min(heights) > 60.0, heights


def test_given_an_arm_in_space_when_drawn_then_its_tip_is_on_the_path_that_it_is_on(show):
    model = LiveModel(crane())
    model.take('state_estimate', state_estimate(1.0, (0.3, 0.8, -0.5)), 0.0)
    *_, tip = model.frame(0.0)['arms']['estimated']
    scene = {'path': [[0.0, 0.0, 0.0], tip], 'obstacle': None}
    (calls,) = show(*take(model, scene=scene), ('show', 'arm', 'calls'))
    drawn = calls[len(calls) - calls[::-1].index(['clearRect', 0, 0, 400, 300]) :]
    ends = [place for name, *place in drawn if name == 'lineTo']
    *_, dot = [place for name, *place in drawn if name == 'arc' and place[2] == 7]
    assert ends.count(dot[:2]) == 2, 'the arm and the path end there'


def test_given_a_page_when_it_is_printed_then_it_is_drawn_for_paper_before(show, model):
    calls = ('show', 'arm', 'calls')
    screen, paper = show(*take(model), calls, ('fire', 'window', 'beforeprint'), calls)
    assert len(paper) > len(screen)


def test_given_many_joints_when_shown_then_each_line_of_the_legend_is_another(show, model):
    eight = {'joints': list('abcdefgh'), 'units': [['rad', 'N m']] * 8}
    (items,) = show(*take(model, **eight)[:2], ('show', 'joints', 'children'))
    keys = [item['children'][0] for item in items]
    looks = {(k['attributes']['class'], *k['children'][0]['attributes'].values()) for k in keys}
    assert len(looks) == 8
