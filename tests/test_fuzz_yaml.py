"""Mutated YAML files of every kind: no traceback, no number that is not finite, clear messages."""

import pytest
from fuzzing import fuzz, mutate_text
from places import BRINGUP, ROOT

from lpv.bag.run.csv_import import load_column_map
from lpv.campaign.plan.spec import parse_spec
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.simulation.scenario import load_scenario
from lpv.core.support.config import read_yaml
from lpv.core.uio.certificate.gains import load_gains
from lpv_design.requirement import load_requirement

pytestmark = pytest.mark.fuzz


_KINDS = {
    'arm': (load_arm, BRINGUP / 'arms' / 'real_arm.yaml'),
    'requirement': (load_requirement, ROOT / 'design/lpv_design/requirements/real_arm.yaml'),
    'scenario': (load_scenario, BRINGUP / 'scenarios' / 'two_faults.yaml'),
    'columns': (load_column_map, BRINGUP / 'columns' / 'real_arm.yaml'),
    'campaign': (
        lambda path: parse_spec(read_yaml(path)),
        BRINGUP / 'campaigns' / 'thresholds.yaml',
    ),
    'gains': (load_gains, BRINGUP / 'gains' / 'real_arm.yaml'),
}
_UNBOUNDED = {
    'arm': ('.effort_bandwidth', '.joints.0.limits.', '.joints.1.limits.'),
    'gains': ('.certificate.guarantee.',),
}
"""Where infinity means that there is no bound, as of an angle without a threshold."""


@pytest.mark.parametrize('kind', _KINDS)
def test_given_mutated_files_when_read_then_each_is_refused_or_holds_finite_numbers(kind, tmp_path):
    load, original = _KINDS[kind]
    text, path = original.read_text(), tmp_path / 'mutated.yaml'

    def mutate(seed):
        path.write_bytes(mutate_text(text, seed))

    assert fuzz(150, mutate, lambda: load(path), unbounded=_UNBOUNDED.get(kind, ())).refused
