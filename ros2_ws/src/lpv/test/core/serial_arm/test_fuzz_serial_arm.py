"""Hostile arm files of n joints and URDFs: refused clearly, or an arm whose torques are finite."""

import numpy as np
import pytest
from fuzzing import bounded_memory, fuzz, mutate_text, mutate_xml
from serial_arms import URDF, shoulder_arm

from lpv.core.serial_arm.arm_file import load_arm, save_arm
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.urdf_chain import read_urdf_chain
from lpv.core.support.errors import ConfigError

pytestmark = pytest.mark.fuzz


def use(arm):
    """The arm's torques in a motion; whatever in its description is not finite but a limit."""
    model, n = SerialModel(compile_chain(arm)), len(arm.joints)
    q, v, a = (np.full(n, value) for value in (0.3, 1.0, 2.0))
    torque = model.torque(q, v, a)
    numbers = [[getattr(j, name) for name in vars(j) if name != 'limits'] for j in arm.joints]
    return {'arm': numbers, 'torque': torque, 'parameters': arm.parameter_vector()}


@pytest.fixture
def good(tmp_path):
    """A good arm file."""
    save_arm(shoulder_arm(), tmp_path / 'arm.yaml')
    use(load_arm(tmp_path / 'arm.yaml'))  # what compiles takes its time
    return tmp_path / 'arm.yaml'


FILES = [('yaml', mutate_text, load_arm), ('urdf', mutate_xml, read_urdf_chain)]


@pytest.mark.parametrize(('kind', 'mutate', 'read'), FILES)
def test_given_mutated_files_then_torques_are_finite_or_why_not_is_said(good, kind, mutate, read):
    path, text = good.with_suffix(f'.{kind}'), good.read_text() if kind == 'yaml' else URDF

    def write(seed):
        path.write_bytes(mutate(text, seed))

    assert fuzz(60, write, lambda: use(read(path))).refused


BOMB = '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa">' + ''.join(
    f'<!ENTITY {new} "{10 * f"&{old};"}">' for old, new in zip('abcdefgh', 'bcdefghi')
) + ']>'  # fmt: skip
JOINT = '<joint name="j{0}" type="{1}"><parent link="l{0}"/><child link="l{2}"/>{3}</joint>'
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def deep(count, kind='fixed'):
    """A chain of so many links."""
    links = ''.join(f'<link name="l{i}"/>' for i in range(count + 1))
    joints = ''.join(JOINT.format(i, kind, i + 1, LIMIT) for i in range(count))
    return f'<robot name="r">{links}{joints}</robot>'


HOSTILE = {
    'entity bomb': BOMB + '<robot name="&i;"><link name="l0"/></robot>',
    'entity bomb in an attribute': BOMB + URDF.replace('name="small"', 'name="&i;"'),
    'file of the system': '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>'
    '<robot name="r">&x;<link name="l0"/></robot>',
    'tree of 100 000 elements': f'<robot name="r">{100_000 * "<a>"}{100_000 * "</a>"}</robot>',
    '20 000 links': deep(20_000),
    '60 joints': deep(60, 'revolute'),
    'loop': deep(3).replace('<child link="l3"/>', '<child link="l1"/>'),
    'joint onto itself': deep(1).replace('<child link="l1"/>', '<child link="l0"/>'),
    'NaN inertia': URDF.replace('ixx="0.02"', 'ixx="nan"'),
    'huge mass': URDF.replace('<mass value="3"/>', '<mass value="1e308"/>'),
    'negative mass': URDF.replace('<mass value="3"/>', '<mass value="-3"/>'),
    'huge length': URDF.replace('xyz="0.4 0 0"', 'xyz="1e200 0 0"'),
    'NaN place': URDF.replace('xyz="0.4 0 0"', 'xyz="nan 0 0"'),
    'no axis': URDF.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>'),
    'NaN limit': URDF.replace('lower="-1"', 'lower="nan"'),
}


@pytest.mark.parametrize('text', HOSTILE.values(), ids=HOSTILE)
def test_given_a_hostile_urdf_when_read_then_it_is_refused_in_one_line(text, tmp_path):
    path = tmp_path / 'hostile.urdf'
    path.write_text(text)
    with bounded_memory(), pytest.raises(ConfigError, match='urdf|joint') as refusal:
        use(read_urdf_chain(path))
    assert '\n' not in str(refusal.value) and len(str(refusal.value)) < 1000
