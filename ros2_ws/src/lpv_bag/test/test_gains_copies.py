"""Gains files that accompany a recording: of either kind of arm, read before they are copied."""

import pytest
from places import BRINGUP

from lpv_bag.rosbag.output_folder import read_gains_file
from lpv_core.support.errors import ConfigError


@pytest.mark.parametrize('name', ['paper', 'ur10'])
def test_given_a_shipped_gains_file_when_read_then_its_bytes_are_to_be_copied(name):
    path = BRINGUP / 'gains' / f'{name}.yaml'
    assert read_gains_file(path) == path.read_bytes()


@pytest.mark.parametrize(
    'text', ['{bandwidth: 10.0, loop: {format: 1}}', '{bandwidth: 10.0, other: 1.0}', '{}']
)
def test_given_a_damaged_file_when_read_then_it_is_refused(tmp_path, text):
    path = tmp_path / 'gains.yaml'
    path.write_text(f'/**: {{ros__parameters: {text}}}\n', encoding='utf-8')
    with pytest.raises(ConfigError):
        read_gains_file(path)
