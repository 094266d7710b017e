import json
import math
import re
from importlib import resources
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from serial_bags import crane

from lpv.core.simulation.faults import KINDS
from lpv_node.view.alarm_list import CLEARED, RAISED, UPDATED, AlarmList
from lpv_node.view.commands import CommandError, parse_command
from lpv_node.view.model import WINDOW, LiveModel

SENSORS = ('link1_angle', 'link2_angle', 'encoder3')


def stamp(t):
    sec = math.floor(t)
    return SimpleNamespace(sec=sec, nanosec=round((t - sec) * 1e9))


def message(t, **fields):
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp(t)), **fields)


def fault_estimate(t, estimate=(0.0, 0.0), alarm=(False, False), state=(0, 0), names=SENSORS):
    arrays = {'estimate': np.array(estimate), 'state': np.array(state, np.uint8)}
    arrays |= dict.fromkeys(('bound', 'threshold'), np.full(len(alarm), 0.1))
    return message(t, sensor_names=names[: len(alarm)], alarm=alarm, **arrays)


def state_estimate(t, position=(1.6, 0.1), mode=0):
    return message(t, position=np.array(position), mode=mode, trustworthy=True)


def alarm(event, t, onset=1.0, sensor=SENSORS[0], **fields):
    values = {'kind': 'bias', 'size': 0.3, 'bound': 0.05, 'confidence': 0.9, **fields}
    decided = t if event == CLEARED else onset + 0.01
    times = {'onset': stamp(onset), 'detected': stamp(decided)}
    return message(t, event=event, sensor=sensor, **times, **values)


def joint_states(t, name, position, velocity=()):
    return message(t, name=name, position=position, velocity=velocity, effort=[])


def report(model, now, name='tracking', level=b'\2', message='m', values=(), arm='paper'):
    fields = {'name': name, 'level': level, 'message': message, 'values': values}
    status = SimpleNamespace(**fields, hardware_id=arm)
    model.take('diagnostics', SimpleNamespace(status=[status]), now)


@pytest.fixture
def model(paper_arm):
    return LiveModel(paper_arm)


def test_given_no_messages_or_those_of_other_arms_when_framed_then_nothing_is_known(model):
    frame = model.frame(0.0)
    assert {frame['mode'], frame['age'], frame['sample']['t'], *frame['arms'].values()} == {None}
    json.dumps(frame, allow_nan=False)
    assert model.hello()['history'] == []
    for source, other in (
        ('fault_estimate', fault_estimate(1.0, (0.0, 0.0, 0.0), (False,) * 3)),
        ('fault_estimate', fault_estimate(1.0, names=('shoulder', 'elbow'))),
        ('state_estimate', state_estimate(1.0, (0.1,))),
        ('reference', message(1.0, tip_position=[0.0] * 9)),
    ):
        assert not model.take(source, other, 0.0)
    frame = model.frame(0.1)
    assert frame['sample']['estimate'] == frame['states'] == [None, None]
    model.take('ground_truth', message(1.0, position=[math.nan, 0.0], fault=[math.nan, 0.1]), 0.0)
    model.take('fault_estimate', fault_estimate(1.0, (math.inf, -0.2)), 0.0)
    model.take('joint_states', joint_states(1.0, ['elbow'], [1.0]), 0.0)
    frame = json.loads(json.dumps(model.frame(0.1), allow_nan=False))
    assert frame['arms'] == {'true': None, 'estimated': None, 'measured': None}
    assert frame['sample']['fault'] == [None, 0.1] and frame['sample']['estimate'] == [None, -0.2]


def test_given_messages_of_all_sources_when_framed_then_the_frame_says_what_they_say(model):
    for source, heard in {
        'state_estimate': state_estimate(1.0, (1.6, 0.1), mode=1),
        'torque_command': message(1.0, torque=[1.0, -2.0], safe_stop=True),
        'ground_truth': message(1.0, position=[1.6, 0.1], fault=[0.0, 0.1]),
        'reference': message(1.0, tip_position=[0.1, 0.0, 1.5]),
    }.items():
        assert model.take(source, heard, 0.0)
    frame = model.frame(0.0)
    assert (frame['mode'], frame['trustworthy'], frame['safe_stop']) == ('HOLDING', True, True)
    assert frame['arms']['true'] == frame['arms']['estimated'] != frame['arms']['measured']
    sample = frame['sample']
    assert (sample['torque'], sample['fault'], sample['tip']) == ([1.0, -2.0], [0, 0.1], [0.1, 1.5])


@pytest.mark.parametrize('rates', [(), (0.0, 0.0, 0.0)])
def test_given_joints_in_another_order_when_framed_then_the_measured_arm_is_the_same(model, rates):
    names = ['gripper', 'joint2', 'joint1']
    model.take('joint_states', joint_states(1.0, names, [9.0, 0.5, 1.0], rates), 0.0)
    # The paper's q1 counts from the x axis; joint 1 is at the base.
    elbow = np.array([np.cos(1.0), np.sin(1.0)])
    corners = [[0.0, 0.0], [0.0, 0.0], elbow, elbow + [np.cos(1.5), np.sin(1.5)]]
    np.testing.assert_allclose(model.frame(0.0)['arms']['measured'], corners, atol=1e-4)


def test_given_a_serial_arm_when_framed_then_each_joint_has_its_values_and_place():
    model = LiveModel(crane())
    rows = (0.0, 0.1, 0.2), (False,) * 3, (0, 1, 4), crane().sensor_names
    model.take('fault_estimate', fault_estimate(1.0, *rows), 0.0)
    model.take('state_estimate', state_estimate(1.0, (0.0, np.pi / 2, 0.0)), 0.0)
    frame, hello = model.frame(0.1), json.loads(json.dumps(model.hello(), allow_nan=False))
    assert frame['states'] == ['OK', 'WARN', 'NOT_DIAGNOSABLE']
    assert frame['sample']['estimate'] == [0.0, 0.1, 0.2]
    assert len(hello['sensors']) == 3 and hello['reach'] == pytest.approx(1.0)
    np.testing.assert_allclose(frame['arms']['estimated'][-1], [0.0, 0.0, 1.0], atol=1e-4)


def test_given_a_source_that_falls_silent_when_framed_then_it_is_no_longer_shown(model):
    model.take('state_estimate', state_estimate(1.0), 10.0)
    assert model.frame(10.5)['arms']['estimated'] is not None
    frame = model.frame(12.0)
    assert frame['arms']['estimated'] is None and not frame['live']['state_estimate']
    assert frame['age'] == 2.0 and frame['mode'] is frame['trustworthy'] is None
    model.take('state_estimate', state_estimate(3.0, mode=4), 13.0)
    assert model.frame(13.0)['arms']['estimated'] is None, 'values of NO_ESTIMATE mean nothing'
    report(model, 20.0)
    early, late = (model.frame(now)['diagnostics'][0]['level'] for now in (29.0, 31.0))
    assert (early, late) == ('ERROR', 'STALE'), 'a node reports no more'


def test_given_a_long_run_when_history_is_asked_for_then_it_is_one_window_without_repeats(model):
    for k in range(2000):
        model.take('fault_estimate', fault_estimate(1.0 + 0.04 * (k // 2)), 0.04 * k)
        model.frame(0.04 * k)
    times = [sample['t'] for sample in model.hello()['history']]
    assert times == sorted(set(times)) and WINDOW - 0.1 < times[-1] - times[0] <= WINDOW
    model.take('fault_estimate', fault_estimate(1.0), 100.0)
    model.frame(100.0)
    assert len(model.hello()['history']) == 1, 'time started anew'


def test_given_an_alarm_that_is_over_when_time_starts_anew_then_it_has_no_place_on_its_axis(model):
    for t, events in ((5.0, (RAISED, CLEARED)), (1.0, ()), (3.0, (RAISED,))):
        for event in events:
            model.take('fault_alarm', alarm(event, t, onset=t), t)
        model.take('fault_estimate', fault_estimate(t), 10.0)
        model.frame(10.0)
    assert [row['past'] for row in model.alarms.rows()] == [True, False]


def test_given_a_source_that_ended_with_the_old_clock_when_time_starts_anew_then_it_goes_on(model):
    model.take('ground_truth', message(50.0, position=[1.0, 0.0], fault=[0.0, 0.0]), 0.0)
    shown = []
    for k, t in enumerate([50.0, *np.arange(1.0, 4.0, 0.1)]):
        model.take('state_estimate', state_estimate(t), 0.1 * k)
        shown.append(model.frame(0.1 * k)['sample']['t'])
    assert (shown[0], shown[-1]) == (50.0, pytest.approx(3.9))
    assert max(sample['t'] for sample in model.hello()['history']) < 4.0


def test_given_a_robot_with_many_other_nodes_when_framed_then_some_and_the_arms_are_there(model):
    for k in range(100):
        report(model, 0.0, f'node {k}' * 100, bytes([k % 4]), 'm' * 9999, arm='camera')
    others = model.frame(0.0)['diagnostics']
    assert 0 < len(others) <= 16
    assert all(len(s['message']) <= 300 and len(s['name']) <= 300 for s in others)
    assert [s['level'] for s in others[:4]] == ['OK', 'WARN', 'ERROR', 'STALE']
    for name, arm in (('tracking', 'paper'), ('elbow', model.hello()['sensors'][1]), ('x', 'y')):
        report(model, 0.0, name, arm=arm)
    *shown, one, two = model.frame(0.0)['diagnostics']
    assert [one['name'], two['name']] == ['tracking', 'elbow'] and one['own'] and two['own']
    assert len(shown) + 2 == len(others) and all(status in others for status in shown)
    for k in range(100):
        report(model, 0.0, f'own {k}')
    assert len(model.frame(0.0)['diagnostics']) <= 16


def test_given_safe_stops_when_framed_then_they_are_counted_with_the_last_reason(model):
    def stops(now, count, last):
        pairs = ('safe stops', count), ('last safe stop', last)
        report(model, now, values=[SimpleNamespace(key=key, value=value) for key, value in pairs])
        return model.frame(now)['stops']

    assert model.frame(0.0)['stops'] == {'count': 0, 'last': '', 'recent': False}
    late = 'estimates come too late'
    assert stops(1.0, '22', late) == {'count': 22, 'last': late, 'recent': True}
    assert not stops(2.0 + WINDOW, '22', 'x')['recent']
    assert {stops(40.0, odd, '')['count'] for odd in ('-1', '', 'x', '9' * 99, '\u00b2')} == {22}


def test_given_the_events_of_one_alarm_when_listed_then_they_are_one_row():
    alarms = AlarmList()
    assert not alarms.changed
    alarms.add(alarm(RAISED, 1.01, kind='unclassified', size=0.29))
    assert alarms.changed and alarms.rows()[0]['ended'] is None
    alarms.add(alarm(UPDATED, 1.5))
    alarms.add(alarm(RAISED, 2.0, onset=1.9, sensor=SENSORS[1]))
    alarms.add(alarm(CLEARED, 3.0, size=0.0, bound=0.0))
    first, second = alarms.rows()
    assert (first['kind'], first['size'], first['ended']) == ('bias', 0.3, 3.0)
    assert first['detected'] == 1.01, 'shaded from there on'
    assert (second['sensor'], second['onset'], second['ended']) == (SENSORS[1], 1.9, None)
    alarms.add(alarm(CLEARED, 5.0, onset=4.0))  # nobody saw its beginning
    assert [row['onset'] for row in alarms.rows()] == [1.0, 1.9, 4.0]
    alarms.changed = False
    alarms.forget_clock()
    assert alarms.changed


def test_given_an_observer_that_was_reset_when_it_reports_no_alarm_then_the_row_ends():
    alarms = AlarmList()
    alarms.add(alarm(RAISED, 1.01))
    for t, is_on, ended in ((1.02, False, None), (2.0, True, None), (2.5, False, 2.5)):
        alarms.changed = False
        alarms.follow(fault_estimate(t, alarm=(is_on, False)))
        assert alarms.rows()[0]['ended'] == ended, 'topics may come in any order'
        assert alarms.changed == (ended is not None)
    alarms.add(alarm(CLEARED, 2.5))
    assert len(alarms.rows()) == 1, 'the event came after the estimate'


@pytest.mark.parametrize('kind', ['dropout', 'rate_bias'])
def test_given_alarms_that_estimates_do_not_hold_when_listed_then_they_last_until_cleared(kind):
    alarms, size = AlarmList(), {'size': 0.0, 'bound': 0.0}
    alarms.add(alarm(RAISED, 1.01))
    alarms.add(alarm(UPDATED if kind == 'dropout' else RAISED, 2.01, 2.0, kind=kind, **size))
    states = (3 * (kind == 'dropout'), 0)
    alarms.follow(fault_estimate(4.0, alarm=(True, False), state=states))
    bias, other = alarms.rows()
    assert (bias['kind'], bias['size'], bias['ended']) == ('bias', 0.3, None)
    assert (other['kind'], other['ended']) == (kind, None)
    alarms.add(alarm(CLEARED, 5.0))
    assert [row['ended'] for row in alarms.rows()] == [5.0, None]
    if kind == 'dropout':  # its end beside another alarm is no event
        alarms.follow(fault_estimate(6.0))
    else:
        alarms.add(alarm(CLEARED, 6.0, 2.0, kind=kind, **size))
    assert [row['ended'] for row in alarms.rows()] == [5.0, 6.0]


def test_given_an_observer_that_begins_anew_when_estimated_then_all_alarms_end(model):
    model.take('fault_alarm', alarm(RAISED, 1.01, kind='rate_bias'), 0.0)
    model.take('state_estimate', state_estimate(2.0), 0.0)
    assert model.alarms.rows()[0]['ended'] is None
    model.take('state_estimate', state_estimate(3.0, mode=2), 0.0)
    assert model.alarms.rows()[0]['ended'] == 3.0


def test_given_endless_alarms_when_listed_then_those_that_last_and_the_newest_are_kept():
    alarms = AlarmList()
    alarms.add(alarm(RAISED, 0.0, onset=0.0, sensor=SENSORS[1]))
    for k in range(1000):
        alarms.add(alarm(RAISED, k + 0.01, onset=float(k)))
    first, *others, newest = alarms.rows()
    assert (first['sensor'], first['ended']) == (SENSORS[1], None)
    assert (len(others), newest['onset'], newest['ended']) == (254, 999.0, None)
    assert None not in [row['ended'] for row in others]
    for k in range(1000):  # of no sensor that there is
        alarms.add(alarm(RAISED, 1000.0, sensor=f'sensor {k}'))
    assert len(alarms.rows()) == 256 and alarms.rows()[-1]['sensor'] == 'sensor 999'


INJECT = {'type': 'inject', 'id': 7, 'sensor': SENSORS[1], 'kind': 'bias', 'size': 1}
JSON = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.lists(st.none())


@given(st.sampled_from(['type', 'id', 'sensor', 'kind', 'size', 'rate', 'duration']), JSON)
@example('size', 10**400)
@example('rate', math.inf)
@example('id', 8)
def test_given_any_value_of_a_field_when_parsed_then_it_is_taken_or_named(name, value):
    data = {**INJECT, 'extra': 'x', name: value}
    text = json.dumps(data).replace('Infinity', '1e999').replace('NaN', '1e999')
    try:
        command = parse_command(text, SENSORS)
    except CommandError as error:
        assert str(error).startswith(f'{name}: ')
        return
    number = type(value) in (int, float) and abs(value) <= 1e9
    assert number or (name == 'id' and type(value) is int and 0 <= value < 2**53)
    known = {'rate': 0.0, 'duration': 0.0, **data}
    fields = {name: known[name] for name in ('sensor', 'kind', 'size', 'rate', 'duration')}
    assert (command.name, command.number, command.fields) == ('inject', data['id'], fields)


@pytest.mark.parametrize(('text', 'told'), [
    ('', 'JSON'), ('{', 'JSON'), ('[' * 4000, 'JSON'), ('{"type": "reset", "id": NaN}', 'JSON'),
    ('[]', 'object'), ('null', 'object'), ('"inject"', 'object'),
    ('{}', 'type'), ('{"type": 3}', 'type'), ('{"type": "inject"}', 'sensor'),
    ('{"type": "clear", "sensor": "elbow"}', 'sensor'), ('{"type": "token"}', 'token'),
    (json.dumps({'type': 'token', 'token': 'x' * 301}), 'token'),
])  # fmt: skip
def test_given_malformed_commands_when_parsed_then_the_reason_is_told(text, told):
    pytest.raises(CommandError, parse_command, text, SENSORS).match(told)


def test_given_the_kinds_of_faults_when_the_page_is_made_then_its_form_knows_them_all():
    script = (resources.files('lpv_node.view') / 'static' / 'view.js').read_text()
    fields = script.split('const FIELDS = {', 1)[1].split('\n};', 1)[0]
    assert set(re.findall(r'(\w+): \{', fields)) == set(KINDS)
