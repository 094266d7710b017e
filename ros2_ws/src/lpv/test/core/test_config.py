import functools
import math
import os
import re
from copy import copy
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from fuzzing import fuzz, mutate_text
from nested import Missing, changed, numbers, places
from places import BRINGUP

from lpv.bag.run.csv_import import load_column_map
from lpv.campaign.plan.spec import parse_spec
from lpv.cli.observing import diagnosis_parameters
from lpv.core.serial_arm import urdf_text
from lpv.core.serial_arm.arm_file import load_arm, parse_arm, save_arm, to_mapping
from lpv.core.serial_arm.two_links import Link
from lpv.core.simulation.faults import KINDS, Fault, FaultInjector
from lpv.core.simulation.scenario import load_scenario, parse_scenario
from lpv.core.support import config
from lpv.core.support.config import (
    MAX_DEPTH,
    MAX_VALUES,
    Section,
    read_yaml,
    sha256_of,
    write_whole,
)
from lpv.core.support.errors import ConfigError, LpvError
from lpv.core.support.resources import shipped_files
from lpv.core.uio.certificate.gains import Gains, load_certified, load_gains
from lpv.core.uio.planar import planar_model
from lpv_design.requirement import load_requirement, parse_requirement

ARM = read_yaml(BRINGUP / 'arms' / 'paper.yaml')
SCENARIO = read_yaml(BRINGUP / 'scenarios' / 'two_faults.yaml')
CAMPAIGN = read_yaml(BRINGUP / 'campaigns' / 'smoke.yaml')
REQUIREMENT = read_yaml(BRINGUP / 'requirements' / 'paper.yaml')
OLD_ARM = yaml.safe_load("""
name: paper
inertia_reference: center_of_mass
gravity: 9.8
links:
  - {mass: 10.0, length: 1.0, center_of_mass: 0.5, inertia: 0.83}
  - {mass: 5.0, length: 1.0, center_of_mass: 0.5, inertia: 0.41}
joints: {names: [joint1, joint2], velocity_limit: 20.0, zero_angle: -1.5707963267948966}
sensors: {names: [link1_angle, link2_angle], arrangement: absolute, position_noise: 0.001,
          velocity_noise: 0.01}
disturbance: {direction: [0.7, 0.0], mean: 0.2, variance: 0.9}
torque_limit: [1500.0, 600.0]
region: {orientation: upright, cos_min: [0.3, 0.3]}
model_error: 0.05
sample_time: 0.002
""")
NEEDED = {
    'arm': 'name joints joints[].name joints[].link.mass joints[].link.first_moment '
    'joints[].link.inertia.yy lpv.orientation lpv.cos_min',
    'scenario': 'name duration path path.waypoints path.waypoints[].t path.waypoints[].x '
    'path.waypoints[].y path.obstacle.center path.obstacle.radius faults[].sensor faults[].kind '
    'faults[].onset',
    'gains': 'format arm_name arm_sha256 observer observer.method observer.kappa observer.mu '
    'observer.lyapunov observer.decay observer.fastest observer.fault_sigma controller '
    'controller.method controller.m1 controller.m2 controller.lyapunov controller.decay',
    'requirement': 'observer observer.method observer.decay observer.fastest '
    'observer.acceleration_noise observer.rate_noise controller controller.method '
    'controller.alpha controller.fastest controller.state_weight controller.torque_weight',
    'old arm': 'name links[].mass links[].length links[].center_of_mass links[].inertia '
    'joints joints.names joints.zero_angle sensors sensors.names sensors.arrangement '
    'sensors.position_noise sensors.velocity_noise disturbance disturbance.direction '
    'disturbance.mean disturbance.variance region region.orientation region.cos_min',
}
PARSERS = {'arm': parse_arm, 'scenario': parse_scenario, 'gains': Gains.parse}
PARSERS |= {'requirement': parse_requirement, 'old arm': parse_arm}
pytestmark = pytest.mark.filterwarnings('ignore:some.yaml is of the form of two-link arms')


class Kind:
    """A kind of file: parser, good content, and how its fields are named in errors."""

    def __init__(self, name, good):
        self.parse, self.needed = PARSERS[name], set(NEEDED[name].split())
        # Names and numbers of a certificate are free.
        self.good = {key: value for key, value in good.items() if key != 'certificate'}
        self.prefix = 'gains.' if name == 'gains' else ''

    def refused(self, field, value):
        """The error that parsing raises: one line that begins with the file and the field."""
        with pytest.raises(ConfigError) as caught:
            self.parse(changed(self.good, field, value), 'some.yaml')
        error = caught.value
        assert isinstance(error, LpvError) and isinstance(error, ValueError)
        several = rf'{len(error.texts)} fields are wrong: \(1\) ' if error.texts[1:] else ''
        assert re.match(rf'some.yaml: {several}{re.escape(error.field)}: ', str(error))
        assert len(str(error)) < 1000
        return error


@pytest.fixture(scope='module')
def kinds(paper_gains, literal_gains):
    good = {'arm': ARM, 'scenario': SCENARIO, 'requirement': REQUIREMENT, 'old arm': OLD_ARM}
    good |= {'gains': paper_gains.mapping(), 'literal gains': literal_gains.mapping()}
    return {name: Kind(name.removeprefix('literal '), data) for name, data in good.items()}


@pytest.fixture(params=NEEDED)
def kind(request, kinds):
    return kinds[request.param]


def test_given_no_number_or_an_unknown_field_in_a_file_when_read_then_it_is_named(kind):
    for field in numbers(kind.good):
        for bad in (math.nan, math.inf, -math.inf, 'heavy', True, None, {'a': 1}):
            found, whole = kind.refused(field, bad).field, kind.prefix + field
            # The field, or the list or mapping that holds it.
            near = whole.startswith((f'{found}.', f'{found}['))
            assert near or f'{found}['.startswith(f'{whole}['), found
    inside = [f'{name}.' for name, value in places(kind.good) if isinstance(value, dict)]
    for place in ['', *inside]:
        error = kind.refused(f'{place}colour', 1.0)
        assert error.field == f'{kind.prefix}{place}colour' and 'known here: ' in error.reason


def test_given_any_field_of_a_file_when_left_out_then_just_those_that_must_be_are_missed(kind):
    missed = set()
    for field, _ in places(kind.good):
        without, (parent, _, name) = changed(kind.good, field, Missing), field.rpartition('.')
        try:
            kind.parse(without, 'some.yaml')
        except ConfigError as error:
            if error.field == kind.prefix + field:
                missed.add(re.sub(r'\[\d+\]', '[]', field))
        else:  # the others are known where there are none, too
            odd, known = f'{parent}.colour'.lstrip('.'), name.partition('[')[0]
            with pytest.raises(ConfigError, match=rf'colour: is not a known .*\b{known}\b'):
                kind.parse(changed(without, odd, 1.0), 'some.yaml')
    assert kind.needed <= missed


FILES = 'arms/paper', 'arms/real_arm', 'arms/ur10', 'scenarios/two_faults', 'scenarios/ur10'


@pytest.mark.parametrize('name', FILES)
def test_given_any_number_of_a_file_when_it_is_huge_then_it_is_refused(name):
    path, is_arm = BRINGUP / f'{name}.yaml', name.startswith('arms')
    parse, options = (parse_arm, {'folder': path.parent}) if is_arm else (parse_scenario, {})
    data = read_yaml(path)
    for field in (one for one in numbers(data) if 'covariance' not in one):
        for huge in (1e300, -1e300):
            pytest.raises(ConfigError, parse, changed(data, field, huge), 'some.yaml', **options)


LONG = functools.reduce(lambda inner, _: [inner, inner], range(14), 'x')
"""As aliases of aliases make it: its text has 100 000 characters."""
BAD = {
    'arm': {
        'sample_time': [-1.0, 1e-6], 'joints[0].link.mass': [-1.0], 'gravity': [-1.0, 10**400],
        'uncertainty.model_error': [1.01], 'lpv.disturbance.variance': [-0.1],
        'lpv.cos_min > lpv.cos_min[0]': [1.0], 'lpv.cos_min > lpv.cos_min[1]': [[0.3, 0.0]],
        'lpv.cos_min': [[0.3, 0.3, 0.3]], 'lpv.orientation': ['sideways'],
        'joints[0].friction.viscous > joints[0].friction': [-0.1], 'joints[0].friction': [[]],
        'joints[1].rotor_inertia': [-1e-5], 'joints[1].limits.torque': [-1.0],
        'joints[1].name > joints': ['joint1'], 'joints[1].name': [''],
        'joints[1].sensors.name > sensors': ['link1_angle'], 'joints[1].sensors.name': [1],
        'joints[1].sensors.rates': ['guessed'], 'joints': [[], {}], 'joints[0]': [5],
        'sensor_matrix': [[[1.0, 0.0]], [[1.0, 0.0], [1.0, 0.0]]], 'name': ['', 5, LONG],
        'tip > tip[2]': [[0, 0, 1e4]], 'joints[0].axis': [[0, 0, 0]],
        'joints[0].limits > joints[0].limits.upper': [{'lower': 1.0, 'upper': 1.0}],
        'joints[0].rotor_coupling': [-0.1],
        'joints[0].torque_tolerance > joints[0].torque_tolerance.speed':
            [{'speed': [1.0, 0.5], 'torque': [1.0, 1.0]}],
    },
    'scenario': {
        'duration': [0.0, -1.0, 2e6], 'seed': [-1, 1.5, 'x', True], 'noise': [1, 'yes', None],
        'plant > plant.model': ['gazebo'], 'plant': [3], 'plant.model': ['linear'],
        'plant.sinc_min': [1.0],
        'plant.mass_factors > plant.mass_factors[1]': [[1.0, 0.0]],
        'plant.parameter_error': [0.9], 'plant.friction': [1], 'disturbance': [3],
        'path.elbow': ['up'], 'path.waypoints': ['all', []], 'path.waypoints[0].t': [-0.5],
        'path.waypoints[1].t > path.waypoints': [0.1], 'path.waypoints[1]': [[0, 0]],
        'path.obstacle': [None], 'path.obstacle.radius': [0], 'path.obstacle.center': [[1, 2, 3]],
        'faults': [{}], 'faults[0].kind': ['melt'], 'faults[0].onset': [-1],
        'faults[1].duration': [-1],
    },
    'gains': {
        'format': [1, '1'], 'observer.method': ['magic'], 'arm_name': [''],
        'observer.method > observer.box': ['paper'],
        'observer.kappa': [[0.1] * 3, 'none'], 'observer.mu[0]': [0.0],
        'observer.kappa[0]': [-1.0], 'observer.fault_sigma': [[0.1]],
        'observer.decay': [0.0, -1.0], 'controller.m1': [[0.0] * 4], 'certificate': [5],
    },
    'literal gains': {
        'observer.r': [20.0],  # a disc that reaches zero
        # A negative bound alarms on everything.
        'observer.fault_sigma > observer.fault_sigma[0]': [[-0.01, 0.01]],
        # Upside down, and without the width that weights divide by.
        'observer.box': [[1.0, -1.0, 1.0, 0.9, 1.0, 0.9], [0.0] * 6],
    },
    'requirement': {
        'observer.decay': [-1], 'observer.decay > observer.fastest': [70.0],
        'observer.acceleration_noise': [[1, 2, 3]], 'observer > observer.method': [{'method': 'x'}],
        'observer > observer.r': [{'method': 'paper', 'q': 20.0, 'r': 20.0}],  # unstable poles
        'controller.alpha > controller.fastest': [200.0], 'controller.torque_weight': [0],
        'controller.state_weight > controller.state_weight[1]': [[10.0, 0.0, 30.0]],
    },
    'old arm': {
        'links[0].mass': [0.0], 'links[0].inertia': [-0.1], 'links': [[OLD_ARM['links'][0]] * 3],
        'joints.zero_angle': [3.2], 'region.cos_min > region.cos_min[1]': [[0.3, 0.0]],
        'sensors.arrangement': ['polar'], 'torque_limit > torque_limit[1]': [[100.0, -1.0]],
        'rotor > rotor.mass': [{'mass': 1.0}],
        'inertia_reference > links': ['joint'],  # 0.83 < 10*0.5^2: no body
    },
}  # fmt: skip
"""Bad values of fields; after > the field that the error names instead."""


VALUES = [
    (kind, k, v) for kind, known in BAD.items() for k, values in known.items() for v in values
]


@pytest.mark.parametrize(('name', 'field', 'value'), VALUES)
def test_given_a_bad_value_in_a_file_when_read_then_its_field_is_named(kinds, name, field, value):
    field, _, named = field.partition(' > ')
    error = kinds[name].refused(field, value)
    assert error.field == kinds[name].prefix + (named or field)
    if field == 'tip':
        assert f'must lie within [-1000.0, 1000.0], got {value[2]}' in str(error)


def test_given_several_wrong_fields_when_read_then_one_error_names_each(tmp_path):
    path, data = tmp_path / 'arm.yaml', {**ARM, 'sample_time': 'long', 'colour': 'red'}
    data = changed(data, 'joints[0].link.mass', -1.0)
    with pytest.raises(ConfigError, match='is not a known field'):
        parse_arm({**data, 1: 2})  # of several types, too
    path.write_text(yaml.safe_dump(changed(data, 'lpv.orientation', 'sideways')))
    with pytest.raises(ConfigError) as caught:
        load_arm(path)
    said = str(caught.value)
    assert said.startswith(f'{path}: 4 fields are wrong: (1) joints[0].link.mass: ')
    told = "sample_time: must be a number, got 'long'", 'colour: is not a known field'
    for begin in (*told, 'lpv.orientation: must be one of upright, hanging'):
        assert f') {begin}' in said and '\n' not in said
    copied = copy(caught.value)  # made as one from a worker's process
    assert (str(copied), vars(copied)) == (said, vars(caught.value))
    wrong = {'faults[0].kind': 'sabotage', 'faults[1].onset': math.inf, 'path.waypoints[2].x': 1e9}
    data = SCENARIO
    for field, value in wrong.items():
        data = changed(data, field, value)
    with pytest.raises(ConfigError) as caught:
        parse_scenario(data)
    assert all(f') {field}: ' in str(caught.value) for field in wrong)


def test_given_the_real_arm_when_read_then_it_is_as_published(real_model):
    assert (real_model.arrangement, real_model.sign) == ('relative', -1.0)
    rotor, ratio = 6.287203962819607e-05, 6.0
    expected = rotor * (ratio**2 + 1), -rotor * ratio, rotor * ratio**2
    np.testing.assert_allclose(real_model.rotor, expected, rtol=1e-12)
    # A disturbance may push either way.
    assert parse_arm(changed(ARM, 'lpv.disturbance.mean', -0.2)).name == 'paper'


def test_given_shipped_arms_and_gains_when_written_then_their_files_read_as_shipped(tmp_path):
    for kind, begin in (('arms', 'name: '), ('gains', '/**:')):
        for name, file in shipped_files(kind).items():
            if kind == 'arms':
                save_arm(load_arm(file), tmp_path / name)
            else:
                load_certified(file).save(tmp_path / name)
            shipped, written = (path.read_text() for path in (file, tmp_path / name))
            assert shipped.partition(begin)[2] == written.partition(begin)[2]


def test_given_an_older_file_when_read_then_it_is_the_same_arm(paper_arm, paper_gains, tmp_path):
    with pytest.warns(FutureWarning, match='some.yaml is of the form of two-link arms'):
        arm = parse_arm(OLD_ARM, 'some.yaml')
        turned = parse_arm({**OLD_ARM, 'rotor': {'inertia': 1e-4, 'gear_ratio': 6.0}}, 'some.yaml')
    planar_model.cache_clear()  # equal arms may differ in the sign of a zero, and so in their hash
    assert planar_model(arm) == planar_model(paper_arm)
    paper_gains.check_arm(arm)
    save_arm(arm, tmp_path / 'new.yaml')
    assert load_arm(tmp_path / 'new.yaml') == arm
    # Rotors are those of the motors.
    assert [j.rotor_inertia for j in turned.joints] == pytest.approx([37e-4, 36e-4])
    assert turned.joints[1].rotor_coupling == pytest.approx(-6e-4)
    with pytest.raises(ConfigError, match='kind: is not a known field'):
        parse_arm({**to_mapping(paper_arm), 'kind': 'serial_arm'})


def larger(value):
    """Another value of the same type, by the smallest change."""
    if isinstance(value, tuple):
        return (*value[:-1], larger(value[-1]))
    if isinstance(value, Link):
        return replace(value, mass=larger(value.mass))
    return f'{value}x' if isinstance(value, str) else math.nextafter(value, math.inf)


def test_given_arms_or_values_when_hashed_then_just_what_matters_counts(tmp_path, paper_model):
    other = {f.name: larger(getattr(paper_model, f.name)) for f in fields(paper_model)}
    other |= {'arrangement': 'relative', 'orientation': 'hanging'}
    del other['rates']  # say nothing to the design
    assert replace(paper_model, rates='derived').sha256() == paper_model.sha256()
    variants = [replace(paper_model, **{name: value}) for name, value in other.items()]
    for i, link in enumerate(paper_model.links):
        for f in fields(Link):
            links = list(paper_model.links)
            links[i] = replace(link, **{f.name: getattr(link, f.name) * 1.25})
            variants.append(replace(paper_model, links=tuple(links)))
    assert len({variant.sha256() for variant in (paper_model, *variants)}) == 1 + len(variants)
    data = changed(ARM, 'joints[0].link.mass', 10)  # an integer for 10.0
    (tmp_path / 'arm.yaml').write_text('# comment\n' + yaml.safe_dump(data, sort_keys=True))
    assert planar_model(load_arm(tmp_path / 'arm.yaml')).sha256() == paper_model.sha256()
    values = [1.0, '1.0', [1.0], {'a': 1.0}, {'a': [1.0]}, {'b': 1.0}, True, None, [[1.0], 2.0],
              [1.0, 2.0], [1.0, [2.0]], 'a', ['a', 'b'], ['a,b'], '']  # fmt: skip
    assert len({sha256_of(v) for v in values}) == len(values)
    assert sha256_of(1) == sha256_of(1.0)
    assert sha256_of((1.0, 2.0)) == sha256_of([1.0, 2.0])
    assert sha256_of({'a': 1, 'b': 2}) == sha256_of({'b': 2, 'a': 1})


YAML = {
    **{text: 'odd.yaml: file: ' for text in (
        'name: !!python/object/apply:os.getcwd []\n',
        'name: !custom {a: 1}\n', 'name: [unclosed\n', 'a: b: c\n', '\tname: x\n',
        '? [list]\n: as key\n', '[' * 1500 + '\n', 'name: "\x00"\n', '- a\n- b\n', 'just text\n',
        '', 'null\n')},
    'name: a\nname: b\n': 'name', 'name: 2001-13-45\n': 'odd.yaml',
    'a: 1' + 5000 * '0': 'odd.yaml', 'a: ' + '9' * 5000: 'is not valid YAML',
    'a: ' + '9' * 400: 'a: must be at most', 'a: 0x' + 'f' * 5000: 'a: must be at most',
    f'a: {{b: [1, {2**63}]}}': r'a.b\[1\]: must be at most',
    'a: !!bool 1': "is not valid YAML .*'1'",
    **dict.fromkeys(('!!bool x: 1', 'a: !!int ""', 'a: !!timestamp x'), 'is not valid YAML'),
    'a: {b: 2001-01-01}': 'a.b: must be a number or text, got a date',
    'a: !!binary YQ==': 'a: must be a number or text, got a bytes',
    'a: !!set {b}': 'a: must be a number or text, got a set',
    'a: [1.0, .nan]': r'a\[1\]: must be a number, got NaN',
    'a: {1: 2}': 'a: has a key that is not text: 1; put it in quotes',
    'on: 2': 'file: has a key that is not text: True',
    '? 0x' + 'f' * 5000: 'a key that is not text: a huge int',
    'a: ' + '[' * 60 + ']' * 60: f'has more than {MAX_DEPTH} levels',
    'a: &x [*x]': f'has more than {MAX_DEPTH} levels',
    'a: &a [' + '1, ' * 10 + ']\n' + ''.join(
        f'{b}: &{b} [' + f'*{a}, ' * 10 + ']\n' for a, b in zip('abcdefghi', 'bcdefghij')
    ): f'has more than {MAX_VALUES} values',
}  # fmt: skip
"""Text of a file, and what is said of it."""


@pytest.mark.parametrize('text', YAML, ids=lambda text: repr(text[:30]))
def test_given_what_no_file_needs_when_read_then_it_is_refused_in_one_line(tmp_path, text):
    (tmp_path / 'odd.yaml').write_text(text)
    with pytest.raises(ConfigError, match=YAML[text]) as error:
        read_yaml(tmp_path / 'odd.yaml')
    assert '\n' not in str(error.value) and len(str(error.value)) < 700 + len(str(tmp_path))


def test_given_large_values_or_files_then_they_are_kept_or_not(tmp_path, monkeypatch, paper_gains):
    text = f'a: [{2**63 - 1}, {-(2**63) + 1}, 1.0e+308, -.inf, null, true, ""]'
    (tmp_path / 'a.yaml').write_text(text)
    expected = [2**63 - 1, -(2**63) + 1, 1e308, float('-inf'), None, True, '']
    assert read_yaml(tmp_path / 'a.yaml')['a'] == expected
    paper_gains.save(tmp_path / 'g.yaml')
    assert 10 * (tmp_path / 'g.yaml').stat().st_size < config.MAX_BYTES < 1 << 24
    path = tmp_path / 'large.yaml'
    path.write_text('name: x\n' + '#' * 100)
    assert read_yaml(path) == {'name': 'x'}
    monkeypatch.setattr(config, 'MAX_BYTES', 100)
    pytest.raises(ConfigError, read_yaml, path).match('large.yaml: file: is larger than 100 bytes')
    monkeypatch.setattr(urdf_text, 'MAX_BYTES', 100)
    for read in read_yaml, urdf_text.read_urdf_text:  # a device does not say how large it is
        with pytest.raises(ConfigError, match='zero: .* is larger than 100 bytes'):
            read(Path('/dev/zero'))


def test_given_names_with_dots_in_a_parameter_file_when_read_then_they_count_as_for_ros(tmp_path):
    path, line = tmp_path / 'a.yaml', '/**: {{ros__parameters: {{diagnosis.{}}}}}'
    path.write_text(line.format('sigmas: 5.0, diagnosis: {latch: true}'))
    found, _ = diagnosis_parameters(path)
    assert (found.sigmas, found.latch) == (5.0, True)
    for wrong in ('sigma: 5.0', 'sigmas: 300.0'):
        path.write_text(line.format(wrong))
        pytest.raises(ConfigError, diagnosis_parameters, path).match(r'diagnosis\.sigma')


def test_given_a_folder_of_that_name_when_written_then_nothing_is_left(tmp_path, paper_gains):
    (tmp_path / 'gains.yaml').mkdir()
    with pytest.raises(ConfigError, match='gains.yaml: file: cannot be written, there is a folder'):
        paper_gains.save(tmp_path / 'gains.yaml')
    assert [path.name for path in tmp_path.iterdir()] == ['gains.yaml']


def test_given_exponents_without_a_dot_when_read_then_numbers_are_numbers_and_names_names(tmp_path):
    path, name = tmp_path / 'a.yaml', {'name': '1e5', 'sensors': {'name': '1e-5'}}
    first, second = ARM['joints']
    first = {**first, **name, 'rotor_inertia': '1e-5', 'torque_gain': '+2.E0'}
    path.write_text(yaml.safe_dump({**ARM, 'joints': [first, second]}))
    assert 'rotor_inertia: 1e-5\n' in path.read_text() and 'name: 1e5\n' in path.read_text()
    for _ in range(2):
        joint = load_arm(path).joints[0]
        assert (joint.rotor_inertia, joint.torque_gain) == (1e-5, 2.0)
        assert (joint.name, joint.sensors.name) == ('1e5', '1e-5')
        save_arm(load_arm(path), path)
    path.write_text('/**: {ros__parameters: {max_gap: 5e-1, diagnosis: {smallest_step: 1e-3}}}')
    found, others = diagnosis_parameters(path)
    assert (found.smallest_step, others['max_gap']) == (1e-3, 0.5)
    factors = {'fault.size': yaml.safe_load('[1e-3, 0.1]'), 'fault.sensor': '1e5'}
    factors['fault.kind'] = 'bias'
    found = parse_spec({**CAMPAIGN, 'factors': factors}).factors
    assert [found[name].values for name in factors] == [(1e-3, 0.1), ('1e5',), ('bias',)]
    for text in ('e5', '1e', '1e5x', '0x1e5', '1e5.0', '1e-999x', '1_0e1', '\u0661e1'):
        with pytest.raises(ConfigError, match='must be a number, got'):
            Section({'a': text}, 'b').number('a')


@pytest.mark.parametrize('load', [load_arm, load_scenario, load_gains, load_requirement])
def test_given_a_file_that_is_none_when_read_then_it_is_named(tmp_path, load):
    latin, folder = tmp_path / 'latin.yaml', tmp_path / 'folder.yaml'
    folder.mkdir()
    latin.write_bytes(b'name: caf\xe9\n')
    for path in (tmp_path / 'none.yaml', folder, latin):
        pytest.raises(ConfigError, load, path).match(re.escape(f'{path}: file: cannot be read'))


def test_given_a_scenario_when_read_then_it_may_have_any_kind_of_fault_and_defaults_are_right():
    data = {'name': 'x', 'duration': 1.0, 'path': {'waypoints': SCENARIO['path']['waypoints']}}
    scenario = parse_scenario(data)
    assert (scenario.seed, scenario.plant, scenario.payload) == (1, 'nonlinear', 0.0)
    assert scenario.noise and scenario.disturbance and scenario.faults == ()
    assert scenario.waypoints.obstacle is None
    assert scenario.mass_factors == scenario.inertia_factors == ()
    for kind in KINDS:
        fault = {'sensor': 'link1_angle', 'kind': kind, 'onset': 1, 'size': 0.1, 'rate': 0.1}
        assert parse_scenario({**SCENARIO, 'faults': [fault]}).faults[0].kind == kind


@pytest.mark.parametrize('name', ['noise', 'disturbance'])
def test_given_a_factor_of_what_is_off_in_a_scenario_when_read_then_it_is_named(name):
    plant = {f'{name}_factor': 2.0}
    assert parse_scenario({**SCENARIO, 'plant': plant})
    with pytest.raises(ConfigError, match=f'plant.{name}_factor: counts only with {name}: true'):
        parse_scenario({**SCENARIO, 'plant': plant, name: False})


@pytest.mark.parametrize(('fault', 'field'), [
    (('x', 'bias', 0.0, 0.0, 1.0), 'sensor'), (('a', 'melt', 0.0), 'kind'),
    (('a', 'bias', 0.0), 'size'), (('a', 'drift', 0.0, 0.0, 1.0), 'rate'),
    (('a', 'noise', 0.0, 0.0, -1.0), 'size'), (('a', 'scale', 0.0), 'size'),
    (('a', 'spike', 0.0, 0.0, 1.0, -1.0), 'rate'), (('a', 'spike', 0.0, 0.0, 1.0), 'rate'),
    (('a', 'bias', math.nan, 0.0, 1.0), 'onset'),
    (('a', 'bias', 0.0, 0.0, math.inf), 'size'), (('a', 'bias', 0.0, -1.0, 1.0), 'duration'),
])  # fmt: skip
def test_given_a_fault_that_cannot_be_injected_when_added_then_its_field_is_named(fault, field):
    injector = FaultInjector(('a', 'b'), (), np.random.default_rng(0))
    pytest.raises(ConfigError, injector.add, Fault(*fault)).match(rf'^fault\.{field}: ')
    assert injector.faults == []


def test_given_gains_when_saved_and_loaded_then_no_bit_differs(tmp_path, gains_of, literal_gains):
    rng = np.random.default_rng(9)  # values that decimal notation spoils
    odd = rng.normal(size=(8, 6, 4)) * 10.0 ** rng.integers(-300, 300, (8, 6, 4))
    odd[0, 0] = [5e-324, 0.1 + 0.2, -0.0, 1.7976931348623157e308]
    spoilt = replace(literal_gains, observer=replace(literal_gains.observer, k=odd))
    path = tmp_path / 'deep' / 'er' / 'gains.yaml'
    for gains in (*gains_of.values(), spoilt):
        gains.save(path, 'two\nlines')
        back = load_gains(path)
        assert (back.arm_name, back.arm_sha256) == (gains.arm_name, gains.arm_sha256)
        for part in ('observer', 'controller'):
            np.testing.assert_equal(asdict(getattr(back, part)), asdict(getattr(gains, part)))
        assert back.certificate == gains.certificate
        assert path.read_text().startswith('# two\n# lines\n/**:')
        assert [p.name for p in path.parent.iterdir()] == ['gains.yaml']  # nothing half-written
    assert back.observer.k.tobytes() == odd.tobytes()


def test_given_other_yaml_or_arm_then_gains_refuse(tmp_path, paper_arm, real_arm, paper_gains):
    path, empty = tmp_path / 'other.yaml', '/**: {ros__parameters: {}}'
    for text in ('a: 1', '/**: 5', empty, empty.replace('{}', '{gains: 5}')):
        path.write_text(text)
        pytest.raises(ConfigError, load_gains, path).match('other.yaml: .*gains')
    with pytest.raises(ConfigError, match='certifies a tracking loop'):
        load_gains(BRINGUP / 'gains' / 'ur10.yaml')
    paper_gains.check_arm(paper_arm)
    hashes = '.*'.join(planar_model(arm).sha256()[:12] for arm in (paper_arm, real_arm))
    with pytest.raises(ConfigError, match=rf'^g.yaml: gains.arm_sha256: .*{hashes}'):
        paper_gains.check_arm(real_arm, 'g.yaml')


# Where infinity means that there is no bound, as of an angle without a threshold, comes last.
MUTATED = {
    'arm': (load_arm, BRINGUP / 'arms' / 'real_arm.yaml', '.effort_bandwidth', '.joints.0.limits.',
            '.joints.1.limits.'),
    'requirement': (load_requirement, BRINGUP / 'requirements' / 'real_arm.yaml'),
    'scenario': (load_scenario, BRINGUP / 'scenarios' / 'two_faults.yaml'),
    'columns': (load_column_map, BRINGUP / 'columns' / 'real_arm.yaml'),
    'campaign': (lambda p: parse_spec(read_yaml(p)), BRINGUP / 'campaigns' / 'thresholds.yaml'),
    'gains': (load_gains, BRINGUP / 'gains' / 'real_arm.yaml', '.certificate.guarantee.'),
}  # fmt: skip


@pytest.mark.fuzz
@pytest.mark.parametrize('kind', MUTATED)
def test_given_mutated_files_when_read_then_each_is_refused_or_holds_finite_numbers(kind, tmp_path):
    load, original, *unbounded = MUTATED[kind]
    text, path = original.read_text(), tmp_path / 'mutated.yaml'

    def mutate(seed):
        path.write_bytes(mutate_text(text, seed))

    assert fuzz(150, mutate, lambda: load(path), unbounded=tuple(unbounded)).refused


def test_given_two_processes_when_they_write_one_file_then_it_is_whole_and_nothing_is_left(
    tmp_path, monkeypatch
):
    def meanwhile(_):
        monkeypatch.setattr(os, 'getpid', lambda: 1)
        write_whole(tmp_path / 'file', 'theirs')

    monkeypatch.setattr(os, 'fsync', meanwhile)
    write_whole(tmp_path / 'file', 'ours', sync=True)
    monkeypatch.setattr(os, 'fsync', lambda _: (tmp_path / 'nothing').read_bytes())
    pytest.raises(OSError, write_whole, tmp_path / 'file', 'half of', sync=True)
    assert (tmp_path / 'file').read_text() == 'ours' and len([*tmp_path.iterdir()]) == 1
