"""Compiled code is kept per state of the sources: no stale machine code may run."""

from lpv_core.support.jit import source_digest


def _package(folder, text):
    (folder / 'sub').mkdir(parents=True)
    (folder / '__init__.py').write_text('')
    (folder / 'sub' / 'module.py').write_text(text)
    return folder


def test_change_in_a_sub_package_gives_another_digest(tmp_path):
    before = _package(tmp_path / 'a', 'x = 1\n')
    after = _package(tmp_path / 'b', 'x = 2\n')
    assert source_digest(before) != source_digest(after)


def test_moved_module_gives_another_digest(tmp_path):
    before = _package(tmp_path / 'a', 'x = 1\n')
    after = _package(tmp_path / 'b', 'x = 1\n')
    (after / 'sub').rename(after / 'other')
    assert source_digest(before) != source_digest(after)


def test_same_sources_elsewhere_give_the_same_digest(tmp_path):
    assert source_digest(_package(tmp_path / 'a', 'x = 1\n')) == source_digest(
        _package(tmp_path / 'b', 'x = 1\n')
    )
