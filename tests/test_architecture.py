"""The import graph: packages and sub-packages in layers, nothing upwards."""

import import_graph
import pytest

LAYERS = [
    {'lpv_core', 'lpv_bringup'},
    {'lpv_design', 'lpv_node'},
    {'lpv_bag', 'lpv_arm_sim', 'lpv_uio', 'lpv_tracker'},
    {'lpv_report', 'lpv_view', 'lpv_ros2cli'},
    {'lpv_campaign', 'lpv_identify'},
    {'lpv', 'lpv_cli'},
]
"""Packages from the bottom up; a package imports lower layers, and its own for `lpv` alone."""

CORE_LAYERS = ('support', 'serial_arm', 'export', 'uio', 'control', 'monitoring', 'simulation')
"""Sub-packages of `lpv_core` from the bottom up."""

LARGE = ('lpv_core', 'lpv_bag', 'lpv_campaign', 'lpv_report')


@pytest.fixture(scope='module')
def modules():
    return import_graph.module_imports()


def test_given_all_modules_when_imports_are_followed_then_there_is_no_cycle(modules):
    import_graph.levels(modules)


@pytest.mark.parametrize('package', LARGE)
def test_given_a_package_when_its_sub_packages_import_then_there_is_no_cycle(modules, package):
    graph = import_graph.collapse(modules, 2)
    inside = {
        name: {other for other in others if other.startswith(package + '.')}
        for name, others in graph.items()
        if name.startswith(package + '.')
    }
    assert len(import_graph.levels(inside)) > 1


def test_given_the_packages_when_they_import_then_only_downwards(modules):
    level = {name: height for height, names in enumerate(LAYERS) for name in names}
    graph = import_graph.collapse(modules, 1)
    assert set(graph) <= set(level)
    upward = {
        (name, other)
        for name, others in graph.items()
        for other in others
        if level[other] > level[name]
    }
    assert upward == set()


def test_given_the_mathematics_when_its_sub_packages_import_then_only_downwards(modules):
    graph = import_graph.collapse(modules, 2)
    allowed = {f'lpv_core.{name}': CORE_LAYERS[:k] for k, name in enumerate(CORE_LAYERS)}
    found = {name for name in graph if name.startswith('lpv_core.')}
    assert found == set(allowed)
    for name in found:
        assert graph[name] <= {f'lpv_core.{lower}' for lower in allowed[name]}, name


def test_given_the_mathematics_when_it_imports_then_never_rclpy():
    for name in ('lpv_core', 'lpv_design', 'lpv_identify'):
        folder = import_graph.package_folders().get(name)
        for file in folder.rglob('*.py') if folder else ():
            assert 'rclpy' not in file.read_text(encoding='utf-8'), file
