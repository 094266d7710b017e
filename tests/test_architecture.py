"""The import graph: packages and sub-packages in layers, nothing upwards."""

import ast

import import_graph
import pytest

LAYERS = [
    {'lpv', 'lpv_bringup'},
    {'lpv_design', 'lpv_node'},
    {'lpv_arm_sim', 'lpv_ros2cli', 'lpv_tracker', 'lpv_uio'},
]
"""Packages from the bottom up; a package imports nothing from higher ones."""

ON_CALL = {('lpv', 'lpv_design')}
"""Imports upwards that wait until a design is asked for."""

PARTS = [{'core'}, {'bag'}, {'report'}, {'campaign', 'identify'}, {'cli'}]
"""Sub-packages of `lpv` from the bottom up; its own modules, the Python API, are above them."""

CORE_LAYERS = ('support', 'serial_arm', 'export', 'uio', 'control', 'monitoring', 'simulation')
"""Sub-packages of `lpv.core` from the bottom up."""


@pytest.fixture(scope='module')
def modules():
    return import_graph.module_imports()


def upward(graph, layers):
    """Imports of a graph that lead to a higher layer; what is in none is on top."""
    level = {name: height for height, names in enumerate(layers) for name in names}
    return {
        (name, other)
        for name, others in graph.items()
        for other in others
        if level.get(other, len(layers)) > level.get(name, len(layers))
    }


def test_given_all_modules_when_imports_are_followed_then_there_is_no_cycle(modules):
    import_graph.levels(modules)


@pytest.mark.parametrize('package', ['core', 'bag', 'campaign', 'report'])
def test_given_a_package_when_its_sub_packages_import_then_there_is_no_cycle(modules, package):
    graph = import_graph.collapse(modules, 3)
    inside = {
        name: {other for other in others if other.startswith(f'lpv.{package}.')}
        for name, others in graph.items()
        if name.startswith(f'lpv.{package}.')
    }
    assert len(import_graph.levels(inside)) > 1


def test_given_the_packages_when_they_import_then_only_downwards(modules):
    graph = import_graph.collapse(modules, 1)
    assert set(graph) == set().union(*LAYERS)
    assert upward(graph, LAYERS) == ON_CALL


def test_given_the_library_when_its_parts_import_then_only_downwards(modules):
    graph = import_graph.collapse(modules, 2)
    inside = {name: others for name, others in graph.items() if name.split('.')[0] == 'lpv'}
    layers = [{f'lpv.{name}' for name in names} for names in PARTS]
    assert set().union(*layers) <= set(inside)
    assert {(a, b) for a, b in upward(inside, layers) if b.split('.')[0] == 'lpv'} == set()


def test_given_the_mathematics_when_its_sub_packages_import_then_only_downwards(modules):
    graph = import_graph.collapse(modules, 3)
    allowed = {f'lpv.core.{name}': CORE_LAYERS[:k] for k, name in enumerate(CORE_LAYERS)}
    found = {name for name in graph if name.startswith('lpv.core.')}
    assert found == set(allowed)
    for name in found:
        assert graph[name] <= {f'lpv.core.{lower}' for lower in allowed[name]}, name


def test_given_the_library_when_imported_then_no_other_package_of_ours_is():
    folder = import_graph.package_folders()['lpv']
    found = [
        f'{file}: {ast.unparse(node)}'
        for file in folder.rglob('*.py')
        # A command is imported when it is called.
        if not file.is_relative_to(folder / 'cli' / 'commands')
        for node in ast.parse(file.read_text(encoding='utf-8')).body
        if ast.unparse(node).startswith(('from lpv_', 'import lpv_'))
    ]
    assert found == []


def test_given_the_mathematics_when_it_imports_then_never_rclpy():
    folders = import_graph.package_folders()
    for folder in (folders['lpv'] / 'core', folders['lpv'] / 'identify', folders['lpv_design']):
        for file in folder.rglob('*.py'):
            assert 'rclpy' not in file.read_text(encoding='utf-8'), file
