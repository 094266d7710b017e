"""Arm, scenario and gains files: errors name the field, nothing passes in silence."""

import copy
import math
import re
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
import yaml
from places import BRINGUP

from lpv_core.serial_arm.arm_file import load_arm, parse_arm
from lpv_core.simulation.faults import KINDS, Fault, FaultInjector
from lpv_core.simulation.scenario import load_scenario, parse_scenario
from lpv_core.support import config
from lpv_core.support.config import read_yaml, sha256_of
from lpv_core.support.errors import ConfigError, LpvError
from lpv_core.uio.certificate.gains import gains_to_dict, load_gains, parse_gains, save_gains
from lpv_core.uio.model.arm import Link
from lpv_core.uio.planar import planar_model

ARM = yaml.safe_load((BRINGUP / 'arms' / 'paper.yaml').read_text())
SCENARIO = yaml.safe_load((BRINGUP / 'scenarios' / 'two_faults.yaml').read_text())


ARM_NEEDS = {
    *('name', 'joints', 'joints[].name', 'joints[].link.mass', 'joints[].link.inertia.yy'),
    *('lpv.orientation', 'lpv.cos_min'),
}
SCENARIO_NEEDS = {
    *('name', 'duration', 'path', 'path.waypoints', 'path.obstacle.center', 'faults[].sensor'),
    *('path.waypoints[].t', 'path.waypoints[].x', 'path.waypoints[].y', 'path.obstacle.radius'),
    *('faults[].kind', 'faults[].onset'),
}
GAINS_NEED = {
    *('format', 'arm_name', 'arm_sha256', 'observer', 'controller', 'observer.method'),
    *('observer.kappa', 'observer.mu', 'observer.lyapunov', 'observer.decay', 'observer.fastest'),
    *('observer.fault_sigma', 'controller.method', 'controller.m1'),
    *('controller.m2', 'controller.lyapunov', 'controller.decay'),
}


class Missing:
    """Stands for: take the field away."""


def changed(data, dotted, value):
    """Deep copy of nested data with one field set or taken away."""
    data = copy.deepcopy(data)
    *parents, last = [int(p) if p.isdigit() else p for p in re.split(r'[.\[\]]+', dotted) if p]
    place = data
    for parent in parents:
        place = place[parent]
    if value is Missing:
        del place[last]
    else:
        place[last] = value
    return data


def refused(parse, data, field):
    """Assert that parsing names the field; return the error."""
    with pytest.raises(ConfigError) as caught:
        parse(data, 'some.yaml')
    assert caught.value.field == field
    assert str(caught.value).startswith(f'some.yaml: {field}: ')
    return caught.value


def refused_near(parse, data, field):
    """Assert that parsing names the field, or the list or mapping that holds it."""
    with pytest.raises(ConfigError) as caught:
        parse(data, 'some.yaml')
    named = caught.value.field
    assert f'{named}['.startswith(f'{field}[') or re.match(re.escape(named) + r'[.\[]', field), (
        named
    )
    return caught.value


def places(data, prefix=''):
    """Dotted names and values of all fields of nested data, from the outside in."""
    pairs = data.items() if isinstance(data, dict) else enumerate(data)
    for key, value in pairs:
        name = f'{prefix}[{key}]' if isinstance(data, list) else f'{prefix}.{key}'.lstrip('.')
        yield name, value
        if isinstance(value, (dict, list)):
            yield from places(value, name)


def is_number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool)


@pytest.fixture(params=['arm', 'scenario', 'gains'])
def kind(request, paper_gains):
    """Parser, good content, fields that may not be left out."""
    return {
        'arm': (parse_arm, ARM, ARM_NEEDS),
        'scenario': (parse_scenario, SCENARIO, SCENARIO_NEEDS),
        'gains': (parse_gains, gains_to_dict(paper_gains), GAINS_NEED),
    }[request.param]


def prefix_of(kind):
    return '' if kind[2] is not GAINS_NEED else 'gains.'


def test_given_any_number_in_a_file_when_it_is_none_then_its_field_is_named(kind):
    parse, good, _ = kind
    for field, value in places(good):
        if not is_number(value) or field.startswith('certificate'):
            continue
        for bad in (math.nan, math.inf, -math.inf, 'heavy', True, None, {'a': 1}):
            error = refused_near(parse, changed(good, field, bad), prefix_of(kind) + field)
            assert len(str(error)) < 1000


def test_given_any_field_of_a_file_when_it_is_left_out_then_just_those_that_must_be_are_missed(
    kind,
):
    parse, good, needed = kind
    missed = set()
    for field, _ in places(good):
        if field.startswith('certificate.'):
            continue  # names of checks
        try:
            parse(changed(good, field, Missing), 'some.yaml')
        except ConfigError as error:
            if error.field == prefix_of(kind) + field:
                missed.add(re.sub(r'\[\d+\]', '[]', field))
    assert needed <= missed


def test_given_an_unknown_field_anywhere_in_a_file_when_read_then_it_is_named_with_the_known_ones(
    kind,
):
    parse, good, _ = kind
    inside = [f'{name}.' for name, value in places(good) if isinstance(value, dict)]
    for place in ['', *(name for name in inside if not name.startswith('certificate'))]:
        field = f'{prefix_of(kind)}{place}colour'
        assert 'known here: ' in refused(parse, changed(good, f'{place}colour', 1.0), field).reason


# ------------------------------------------------------------------ arm files


def test_given_the_shipped_arms_when_read_then_they_are_as_published(paper_model, real_model):
    assert paper_model.lengths == (1.0, 1.0)
    assert (paper_model.gravity, paper_model.arrangement, paper_model.sign) == (9.8, 'absolute', 1)
    assert (paper_model.disturbance_mean, paper_model.disturbance_variance) == (0.2, 0.9)
    assert paper_model.disturbance_direction == (0.7, 0.0)
    assert (real_model.arrangement, real_model.sign) == ('relative', -1.0)
    rotor, ratio = 6.287203962819607e-05, 6.0
    expected = rotor * (ratio**2 + 1), -rotor * ratio, rotor * ratio**2
    np.testing.assert_allclose(real_model.rotor, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ('field', 'value', 'named'),
    [
        *[(f, v, f) for f in ('sample_time', 'joints[0].link.mass') for v in (-1.0,)],
        ('gravity', -1.0, 'gravity'),
        ('uncertainty.model_error', 1.01, 'uncertainty.model_error'),
        ('sample_time', 1e-6, 'sample_time'),
        ('lpv.disturbance.variance', -0.1, 'lpv.disturbance.variance'),
        ('lpv.cos_min', 1.0, 'lpv.cos_min[0]'),
        ('lpv.cos_min', [0.3, 0.0], 'lpv.cos_min[1]'),
        ('lpv.cos_min', [0.3, 0.3, 0.3], 'lpv.cos_min'),
        ('lpv.orientation', 'sideways', 'lpv.orientation'),
        ('lpv.disturbance.direction', [0.7, math.nan], 'lpv.disturbance.direction[1]'),
        ('joints[0].friction.viscous', -0.1, 'joints[0].friction'),
        ('joints[0].friction.coulomb', 'dry', 'joints[0].friction.coulomb'),
        ('joints[0].friction', [], 'joints[0].friction'),
        ('joints[1].rotor_inertia', -1e-5, 'joints[1].rotor_inertia'),
        ('joints[1].limits.torque', -1.0, 'joints[1].limits.torque'),
        ('joints[1].name', 'joint1', 'joints'),
        ('joints[1].name', '', 'joints[1].name'),
        ('joints[1].sensors.name', 'link1_angle', 'sensors'),
        ('joints[1].sensors.name', 1, 'joints[1].sensors.name'),
        ('joints', [], 'joints'),
        ('joints', {}, 'joints'),
        ('joints[0]', 5, 'joints[0]'),
        ('sensor_matrix', [[1.0, 0.0], [1.0, 0.0]], 'sensor_matrix'),
        ('sensor_matrix', [[1.0, 0.0]], 'sensor_matrix'),
        ('name', '', 'name'),
        ('name', 5, 'name'),
        ('lpv.disturbance.mean', -0.2, None),
    ],
)
def test_given_a_bad_value_in_an_arm_file_when_read_then_its_field_is_named(field, value, named):
    data = changed(ARM, field, value)
    if named is None:
        assert parse_arm(data).name == 'paper'
    else:
        refused(parse_arm, data, named)


def test_given_any_parameter_when_changed_then_the_hash_changes(paper_model):
    seen = {paper_model.sha256()}
    other = {
        'name': 'x',
        'inertia_reference': 'center_of_mass',
        'gravity': 9.81,
        'rotor': (0.0, 0.0, 1e-9),
        'friction_error': 0.4,
        'viscous': (0.0, 1e-9),
        'coulomb': (1e-9, 0.0),
        'coulomb_slope': 99.0,
        'joint_names': ('a', 'b'),
        'zero_angle': 0.0,
        'sensor_names': ('a', 'b'),
        'arrangement': 'relative',
        'position_noise': 2e-3,
        'velocity_noise': 2e-2,
        'disturbance_direction': (0.7, 1e-12),
        'disturbance_mean': 0.3,
        'disturbance_variance': 0.8,
        'model_error': 0.04,
        'torque_limit': (1500.0, 601.0),
        'velocity_limit': (20.0, 21.0),
        'payload': 0.1,
        'velocity_error': 0.1,
        'torque_tolerance': (1.0, 0.0),
        'orientation': 'hanging',
        'cos_min': (0.3, 0.31),
        'sample_time': 0.001,
        'links': (
            replace(paper_model.links[0], mass=math.nextafter(10.0, 11.0)),
            paper_model.links[1],
        ),
    }
    # What rates are says nothing to the design.
    assert set(other) == {f.name for f in fields(paper_model)} - {'rates'}
    variants = [replace(paper_model, **{name: value}) for name, value in other.items()]
    for i, link in enumerate(paper_model.links):
        for f in fields(Link):
            links = list(paper_model.links)
            links[i] = replace(link, **{f.name: getattr(link, f.name) * 1.25})
            variants.append(replace(paper_model, links=tuple(links)))
    for variant in variants:
        seen.add(variant.sha256())
    assert len(seen) == 1 + len(variants)


def test_given_the_same_parameters_in_another_layout_when_hashed_then_the_hash_is_the_same(
    tmp_path, paper_model
):
    path = tmp_path / 'arm.yaml'
    data = changed(ARM, 'gravity', 9.8)
    data['joints'][0]['link']['mass'] = 10  # an integer for 10.0
    path.write_text('# comment\n' + yaml.safe_dump(data, sort_keys=True))
    assert planar_model(load_arm(path)).sha256() == paper_model.sha256()


def test_given_texts_and_numbers_when_hashed_then_types_and_nesting_count():
    values = [
        1.0,
        '1.0',
        [1.0],
        {'a': 1.0},
        {'a': [1.0]},
        {'b': 1.0},
        True,
        None,
        [[1.0], 2.0],
        [1.0, 2.0],
        [1.0, [2.0]],
        'a',
        ['a', 'b'],
        ['a,b'],
        '',
    ]
    assert len({sha256_of(v) for v in values}) == len(values)
    assert sha256_of(1) == sha256_of(1.0)
    assert sha256_of((1.0, 2.0)) == sha256_of([1.0, 2.0])
    assert sha256_of({'a': 1, 'b': 2}) == sha256_of({'b': 2, 'a': 1})


# ------------------------------------------------------------------ YAML itself


@pytest.mark.parametrize(
    'text',
    [
        'name: !!python/object/apply:os.getcwd []\n',
        'name: !!python/name:os.system\n',
        'name: !!python/object/new:os.system [echo]\n',
        '!!python/tuple [1, 2]\n',
        'name: !custom {a: 1}\n',
        'name: [unclosed\n',
        'a: b: c\n',
        '\tname: x\n',
        '? [list]\n: as key\n',
        '[' * 1500 + '\n',
        'name: "\x00"\n',
        '- a\n- b\n',
        'just text\n',
        '',
        'null\n',
    ],
)
def test_given_yaml_that_is_no_plain_mapping_when_read_then_it_is_refused_with_its_name(
    tmp_path, text
):
    path = tmp_path / 'odd.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError, match='odd.yaml: file: '):
        read_yaml(path)


@pytest.mark.parametrize('load', [load_arm, load_scenario, load_gains])
def test_given_an_object_tag_when_any_kind_of_file_is_read_then_nothing_is_constructed(
    tmp_path, load
):
    path, trace = tmp_path / 'odd.yaml', tmp_path / 'trace'
    path.write_text(f'name: !!python/object/apply:pathlib.Path.touch [{trace}]\n')
    with pytest.raises(ConfigError, match='odd.yaml: file: is not valid YAML'):
        load(path)
    assert not trace.exists()


@pytest.mark.parametrize('text', ['name: 2001-13-45\n', 'name: 1' + 5000 * '0' + '\n'])
def test_given_a_scalar_that_python_refuses_when_read_then_it_is_refused_with_its_name(
    tmp_path, text
):
    path = tmp_path / 'odd.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError, match='odd.yaml'):
        read_yaml(path)


def test_given_an_integer_that_no_float_holds_when_read_then_its_field_is_named():
    refused(parse_arm, changed(ARM, 'gravity', 10**400), 'gravity')


def test_given_unknown_keys_of_different_types_when_read_then_they_are_unknown():
    with pytest.raises(ConfigError, match='is not a known field'):
        parse_arm({**ARM, 1: 2, 'foo': 3})


def test_given_aliases_of_aliases_when_read_then_the_message_stays_short(tmp_path):
    lines = ['a0: &a0 [x, x]'] + [f'a{i}: &a{i} [*a{i - 1}, *a{i - 1}]' for i in range(1, 14)]
    path = tmp_path / 'many.yaml'
    path.write_text('\n'.join([*lines, 'name: *a13\n']))
    with pytest.raises(ConfigError, match='name: must be a non-empty string') as caught:
        load_arm(path)
    assert len(str(caught.value)) < 1000


def test_given_a_key_twice_when_read_then_it_is_refused(tmp_path):
    path = tmp_path / 'twice.yaml'
    path.write_text('name: a\nname: b\n')
    with pytest.raises(ConfigError, match='name'):
        read_yaml(path)


def test_given_a_file_that_is_too_large_when_read_then_it_is_refused_unread(tmp_path, monkeypatch):
    path = tmp_path / 'large.yaml'
    path.write_text('name: x\n' + '#' * 100)
    assert read_yaml(path) == {'name': 'x'}
    monkeypatch.setattr(config, 'MAX_BYTES', 100)
    with pytest.raises(ConfigError, match='large.yaml: file: is larger than 100 bytes'):
        read_yaml(path)


def test_given_the_size_limit_when_compared_with_a_gains_file_then_there_is_room(
    tmp_path, paper_gains
):
    save_gains(paper_gains, tmp_path / 'g.yaml')
    assert 10 * (tmp_path / 'g.yaml').stat().st_size < config.MAX_BYTES < 1 << 24


def test_given_nothing_or_a_folder_when_read_then_the_file_is_named(tmp_path):
    for path in (tmp_path / 'none.yaml', tmp_path):
        for load in (load_arm, load_scenario, load_gains):
            with pytest.raises(ConfigError, match=re.escape(f'{path}: file: cannot be read')):
                load(path)


def test_given_bytes_that_are_no_utf_8_when_read_then_the_file_is_named(tmp_path):
    path = tmp_path / 'latin.yaml'
    path.write_bytes(b'name: caf\xe9\n')
    with pytest.raises(ConfigError, match='latin.yaml: file: cannot be read'):
        load_arm(path)


def test_given_a_config_error_when_caught_then_it_is_also_the_packages_and_a_value_error():
    error = ConfigError('a.b', 'is wrong')
    assert isinstance(error, LpvError)
    assert isinstance(error, ValueError)
    assert str(error) == 'a.b: is wrong'


# ------------------------------------------------------------------ scenario files


def test_given_the_shipped_scenario_when_read_then_both_faults_overlap(two_faults):
    one, two = two_faults.faults
    assert (one.kind, two.kind) == ('bias', 'drift')
    assert one.onset < two.onset < one.onset + one.duration < two.onset + two.duration
    assert (two_faults.plant, two_faults.noise, two_faults.disturbance) == ('nonlinear', True, True)


@pytest.mark.parametrize(
    ('field', 'value', 'named'),
    [
        *[('duration', v, 'duration') for v in (0.0, -1.0, 2e6)],
        *[('seed', v, 'seed') for v in (-1, 1.5, 'x', True)],
        *[('noise', v, 'noise') for v in (1, 'yes', None)],
        ('plant.model', 'linear', 'plant.model'),
        ('plant.sinc_min', 1.0, 'plant.sinc_min'),
        ('plant.mass_factors', [1.0, 0.0], 'plant.mass_factors'),
        ('plant.payload', math.inf, 'plant.payload'),
        ('path.elbow', 'up', 'path.elbow'),
        ('path.waypoints', 'all', 'path.waypoints'),
        ('path.waypoints[0].t', -0.5, 'path.waypoints[0].t'),
        ('path.waypoints[1]', [0, 0], 'path.waypoints[1]'),
        ('path.obstacle', None, 'path.obstacle'),
        ('path.obstacle.radius', 0, 'path.obstacle.radius'),
        ('path.obstacle.center', [1, 2, 3], 'path.obstacle.center'),
        ('faults', {}, 'faults'),
        ('faults[0].kind', 'melt', 'faults[0].kind'),
        ('faults[0].onset', -1, 'faults[0].onset'),
        ('faults[1].duration', -1, 'faults[1].duration'),
        ('plant.friction', 1, 'plant.friction'),
    ],
)
def test_given_a_bad_value_in_a_scenario_file_when_read_then_its_field_is_named(
    field, value, named
):
    refused(parse_scenario, changed(SCENARIO, field, value), named)


def test_given_a_scenario_without_options_when_read_then_defaults_are_the_true_arm():
    data = {'name': 'x', 'duration': 1.0, 'path': {'waypoints': SCENARIO['path']['waypoints']}}
    scenario = parse_scenario(data)
    assert (scenario.seed, scenario.plant, scenario.payload) == (1, 'nonlinear', 0.0)
    assert scenario.noise
    assert scenario.disturbance
    assert scenario.faults == ()
    assert scenario.waypoints.obstacle is None
    assert scenario.mass_factors == scenario.inertia_factors == ()


@pytest.mark.parametrize(
    ('fault', 'field'),
    [
        (Fault('x', 'bias', 0.0, size=1.0), 'sensor'),
        (Fault('a', 'melt', 0.0), 'kind'),
        (Fault('a', 'bias', 0.0), 'size'),
        (Fault('a', 'drift', 0.0, size=1.0), 'rate'),
        (Fault('a', 'noise', 0.0, size=-1.0), 'size'),
        (Fault('a', 'scale', 0.0), 'size'),
        (Fault('a', 'spike', 0.0, size=1.0, rate=-1.0), 'rate'),
        (Fault('a', 'bias', math.nan, size=1.0), 'onset'),
        (Fault('a', 'bias', 0.0, size=math.inf), 'size'),
        (Fault('a', 'bias', 0.0, duration=-1.0, size=1.0), 'duration'),
    ],
)
def test_given_a_fault_that_cannot_be_injected_when_added_then_its_field_is_named(fault, field):
    injector = FaultInjector(('a', 'b'), (), np.random.default_rng(0))
    with pytest.raises(ConfigError) as caught:
        injector.add(fault)
    assert caught.value.field == f'fault.{field}'
    assert injector.faults == []


def test_given_every_kind_of_fault_when_listed_then_a_scenario_file_may_name_it():
    for kind in KINDS:
        data = changed(
            SCENARIO,
            'faults',
            [{'sensor': 'link1_angle', 'kind': kind, 'onset': 1, 'size': 0.1, 'rate': 0.1}],
        )
        assert parse_scenario(data).faults[0].kind == kind


# ------------------------------------------------------------------ gains files


@pytest.fixture(scope='module')
def gains_data(paper_gains):
    return gains_to_dict(paper_gains)


def plain(value):
    """A record as a mapping, which can be compared with its arrays."""
    return vars(value) if is_dataclass(value) else value


@pytest.mark.parametrize('which', ['paper', 'real_arm', 'literal'])
def test_given_gains_when_saved_and_loaded_then_every_bit_is_the_same(
    tmp_path, gains_of, literal_gains, which
):
    gains = {**gains_of, 'literal': literal_gains}[which]
    path = tmp_path / 'deep' / 'er' / 'gains.yaml'
    save_gains(gains, path, 'two\nlines')
    back = load_gains(path)
    assert (back.arm_name, back.arm_sha256) == (gains.arm_name, gains.arm_sha256)
    for part in ('observer', 'controller'):
        one, two = getattr(gains, part), getattr(back, part)
        for f in fields(one):
            np.testing.assert_equal(plain(getattr(two, f.name)), plain(getattr(one, f.name)))
    assert back.certificate == gains.certificate
    assert path.read_text().startswith('# two\n# lines\n/**:')
    assert [p.name for p in path.parent.iterdir()] == ['gains.yaml']  # nothing half-written


def test_given_values_that_decimal_notation_spoils_when_round_tripped_then_they_are_exact(
    tmp_path, literal_gains
):
    rng = np.random.default_rng(9)
    odd = rng.normal(size=(8, 6, 4)) * 10.0 ** rng.integers(-300, 300, (8, 6, 4))
    odd[0, 0] = [5e-324, 0.1 + 0.2, -0.0, 1.7976931348623157e308]
    gains = replace(literal_gains, observer=replace(literal_gains.observer, k=odd))
    save_gains(gains, tmp_path / 'g.yaml')
    back = load_gains(tmp_path / 'g.yaml').observer.k
    assert back.tobytes() == odd.tobytes()


@pytest.mark.parametrize(
    ('field', 'value', 'named'),
    [
        ('format', 1, 'gains.format'),
        ('format', '1', 'gains.format'),
        ('observer.method', 'magic', 'gains.observer.method'),
        ('observer.method', 'paper', 'gains.observer.box'),
        ('observer.kappa', [0.1] * 3, 'gains.observer.kappa'),
        ('observer.kappa', 'none', 'gains.observer.kappa'),
        ('observer.mu[0]', 0.0, 'gains.observer.mu'),
        ('observer.kappa[0]', -1.0, 'gains.observer.kappa'),
        ('observer.fault_sigma', [0.1], 'gains.observer.fault_sigma'),
        ('observer.decay', 0.0, 'gains.observer.decay'),
        ('observer.decay', -1.0, 'gains.observer.decay'),
        ('controller.m1', [0.0] * 4, 'gains.controller.m1'),
        ('certificate', 5, 'gains.certificate'),
        ('arm_name', '', 'gains.arm_name'),
    ],
)
def test_given_a_bad_value_in_a_gains_file_when_read_then_its_field_is_named(
    gains_data, field, value, named
):
    refused(parse_gains, changed(gains_data, field, value), named)


@pytest.mark.parametrize(
    ('field', 'value'),
    [
        ('observer.r', 20.0),  # a disc that reaches zero
        ('observer.fault_sigma', [-0.01, 0.01]),  # a negative bound alarms on everything
        ('observer.box', [1.0, -1.0, 1.0, 0.9, 1.0, 0.9]),  # upside down
        ('observer.box', [0.0] * 6),  # weights divide by its width
    ],
)
def test_given_an_impossible_value_in_a_gains_file_when_read_then_it_is_named(
    literal_gains, field, value
):
    data = changed(gains_to_dict(literal_gains), field, value)
    with pytest.raises(ConfigError, match=f'gains.{field}'):
        parse_gains(data)


@pytest.mark.parametrize(
    'text',
    ['a: 1\n', '/**: 5\n', '/**: {ros__parameters: {}}\n', '/**: {ros__parameters: {gains: 5}}\n'],
)
def test_given_another_yaml_file_when_read_as_gains_then_it_is_refused(tmp_path, text):
    path = tmp_path / 'other.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError, match='other.yaml: .*gains'):
        load_gains(path)


def test_given_gains_when_checked_against_another_arm_then_both_hashes_are_told(
    paper_model, real_model, paper_gains
):
    paper_gains.check_arm(paper_model)
    with pytest.raises(ConfigError) as caught:
        paper_gains.check_arm(real_model, 'g.yaml')
    assert caught.value.field == 'gains.arm_sha256'
    for text in ('g.yaml', paper_model.sha256()[:12], real_model.sha256()[:12]):
        assert text in str(caught.value)


# ------------------------------------------------------------------ all errors, and ranges


def test_given_several_wrong_fields_when_read_then_one_error_names_each(tmp_path):
    data = changed(ARM, 'joints[0].link.mass', -1.0)
    data = changed(data, 'sample_time', 'long')
    data = changed(data, 'lpv.orientation', 'sideways')
    data = changed(data, 'colour', 'red')
    path = tmp_path / 'arm.yaml'
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError) as caught:
        load_arm(path)
    said = str(caught.value)
    assert said.startswith(f'{path}: 4 fields are wrong: (1) joints[0].link.mass: ')
    assert '\n' not in said
    for begin in (
        "sample_time: must be a number, got 'long'",
        'lpv.orientation: must be one of upright, hanging',
        'colour: is not a known field',
    ):
        assert f') {begin}' in said


def test_given_wrong_faults_and_waypoints_when_read_then_all_are_named():
    data = changed(SCENARIO, 'faults[0].kind', 'sabotage')
    data = changed(data, 'faults[1].onset', math.inf)
    data = changed(data, 'path.waypoints[2].x', 1e9)
    with pytest.raises(ConfigError) as caught:
        parse_scenario(data)
    said = str(caught.value)
    for field in ('faults[0].kind', 'faults[1].onset', 'path.waypoints[2].x'):
        assert f') {field}: ' in said


@pytest.mark.parametrize('value', [-1e308, 1e308, 1e4])
def test_given_numbers_that_no_arm_has_when_read_then_field_value_and_range_are_named(value):
    arm = yaml.safe_load((BRINGUP / 'arms' / 'ur10.yaml').read_text())
    error = refused(parse_arm, {**arm, 'tip': [0, 0, value]}, 'tip[2]')
    assert f'must lie within [-100.0, 100.0], got {value}' in str(error)


def numbers(data, place=()):
    """Places of all numbers in nested data."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        if isinstance(value, (dict, list)):
            yield from numbers(value, (*place, key))
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            yield (*place, key)


@pytest.mark.parametrize(
    ('parse', 'file'),
    [
        (parse_arm, 'arms/paper.yaml'),
        (parse_arm, 'arms/real_arm.yaml'),
        (parse_arm, 'arms/ur10.yaml'),
        (parse_scenario, 'scenarios/two_faults.yaml'),
        (parse_scenario, 'scenarios/ur10.yaml'),
    ],
)
@pytest.mark.parametrize('huge', [1e300, -1e300])
def test_given_any_number_of_a_file_when_it_is_huge_then_it_is_refused(parse, file, huge):
    path = BRINGUP / file
    data = yaml.safe_load(path.read_text())
    for place in numbers(data):
        if 'covariance' in place:
            continue
        wrong = yaml.safe_load(path.read_text())
        holder = wrong
        for key in place[:-1]:
            holder = holder[key]
        holder[place[-1]] = huge
        options = {'folder': path.parent} if parse is parse_arm else {}
        with pytest.raises(ConfigError):
            parse(wrong, 'some.yaml', **options)
