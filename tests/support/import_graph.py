"""Which package and sub-package imports which, read from the sources."""

import ast
from collections import defaultdict

from places import PACKAGES, ROOT


def package_folders():
    """Python packages by name; lpv_design is in ``design/``, our ros2 command in ``tools/``."""
    folders = {path.name: path / path.name for path in PACKAGES.glob('lpv*')}
    folders['lpv_design'] = ROOT / 'design' / 'lpv_design'
    folders['lpv_ros2cli'] = ROOT / 'tools' / 'lpv_ros2cli' / 'lpv_ros2cli'
    return {name: path for name, path in sorted(folders.items()) if path.is_dir()}


def module_name(file, package):
    """Dotted name of a module file of a package."""
    parts = file.relative_to(package.parent).with_suffix('').parts
    return '.'.join(parts[:-1] if parts[-1] == '__init__' else parts)


def module_files():
    """Files of all modules of the workspace by their dotted names."""
    return {
        module_name(file, folder): file
        for folder in package_folders().values()
        for file in sorted(folder.rglob('*.py'))
    }


def module_imports():
    """Modules of the workspace that each module imports, lazy imports included."""
    files, graph = module_files(), {}
    for module, file in files.items():
        found = set()
        for node in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                found.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    inner = f'{node.module}.{alias.name}'
                    found.add(inner if inner in files else node.module)
        graph[module] = (found & files.keys()) - {module}
    return graph


def collapse(graph, depth):
    """The graph between packages (depth 1) or sub-packages (depth 2)."""

    def short(module):
        return '.'.join(module.split('.')[:depth])

    result = defaultdict(set)
    for module, imported in graph.items():
        result[short(module)].update(short(name) for name in imported)
    return {name: others - {name} for name, others in result.items()}
