"""The import graph: packages and sub-packages in layers, nothing upwards."""

import re
from graphlib import TopologicalSorter

import import_graph
import pytest

LAYERS = {
    '': [
        {'lpv', 'lpv_bringup'},
        {'lpv_design', 'lpv_node'},
        {'lpv_arm_sim', 'lpv_ros2cli', 'lpv_tracker', 'lpv_uio'},
    ],
    # Its own modules, the Python API, are above them.
    'lpv.': [{'core'}, {'bag'}, {'report'}, {'campaign', 'identify'}, {'cli'}],
    'lpv.core.': [
        *({'support'}, {'serial_arm'}, {'export'}, {'uio'}, {'control'}, {'monitoring'}),
        {'simulation'},
    ],
}
"""What is in a package, from the bottom up; nothing imports from higher layers."""
ON_CALL = {'': {('lpv', 'lpv_design')}}
"""Imports upwards that wait until a design is asked for."""


@pytest.fixture(scope='module')
def modules():
    return import_graph.module_imports()


@pytest.mark.parametrize('package', ['', 'lpv.bag.', 'lpv.campaign.', 'lpv.report.'])
def test_given_modules_or_sub_packages_when_they_import_then_there_is_no_cycle(modules, package):
    graph = import_graph.collapse(modules, 3 if package else 99)
    inside = {
        name: {other for other in others if other.startswith(package)}
        for name, others in graph.items()
        if name.startswith(package)
    }
    TopologicalSorter(inside).prepare()
    assert any(inside.values())


@pytest.mark.parametrize(('package', 'layers'), LAYERS.items())
def test_given_layers_when_what_is_in_them_imports_then_only_downwards(modules, package, layers):
    graph = import_graph.collapse(modules, package.count('.') + 1)
    level = {f'{package}{name}': height for height, names in enumerate(layers) for name in names}
    inside = {name for name in graph if name.startswith(package)}
    files = import_graph.module_files()
    assert level.keys() == {name for name in inside if files[name].name == '__init__.py'}
    upward = {
        (name, other)
        for name in inside
        for other in graph[name]
        if other.startswith(package[:4])
        and level.get(other, len(layers)) > level.get(name, len(layers))
    }
    assert upward == ON_CALL.get(package, set())


def test_given_the_mathematics_when_it_imports_then_nothing_else_of_ours_and_never_rclpy(modules):
    for name, others in modules.items():
        if name.startswith('lpv.core.'):
            assert all(other.startswith('lpv.core') for other in others), name
    for name, file in import_graph.module_files().items():
        if name.startswith(('lpv.core', 'lpv.identify', 'lpv_design')):
            assert 'rclpy' not in file.read_text(encoding='utf-8'), file


def test_given_the_library_when_imported_then_no_other_package_of_ours_is():
    for name, file in import_graph.module_files().items():
        # A command is imported when it is called.
        if name.split('.')[0] == 'lpv' and not name.startswith('lpv.cli.commands'):
            text = file.read_text(encoding='utf-8')
            assert not re.search(r'^(from|import) lpv_', text, re.MULTILINE), name
