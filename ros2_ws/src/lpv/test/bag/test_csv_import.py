import math
import re

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from places import BRINGUP

from lpv.bag.rosbag import writing
from lpv.bag.rosbag.reading import open_bag
from lpv.bag.run.csv_import import (
    ANGLE_UNITS,
    TIME_UNITS,
    UNITS,
    CsvError,
    import_csv,
    load_column_map,
)
from lpv.core.support.errors import ConfigError
from lpv.core.support.timestamps import to_nanoseconds

COLUMNS = """
time: {column: t, unit: s}
joints:
  shoulder: {position: q1, velocity: w1, effort: u1}
  elbow: {position: q2, velocity: w2, effort: u2}
"""
KEPT = COLUMNS.replace('unit: s', 'unit: s, keep: true')
NAMES = ('t', 'q1', 'q2', 'w1', 'w2', 'u1', 'u2')
HEADER = ','.join(NAMES) + '\n'
LINES = ''.join(f'{k / 500},{k}.1,{k}.2,{k}.3,{k}.4,{k}.5,{k}.6\n' for k in range(3))
SECOND, MS = 1_000_000_000, 1_000_000
NAN = math.nan
CELL, TIMES = st.floats(-1e6, 1e6) | st.just(NAN), st.integers(0, 2**31 * SECOND - 1)
ROWS = st.dictionaries(TIMES, st.lists(CELL, min_size=6, max_size=6), min_size=1, max_size=5)


@pytest.fixture(scope='module')
def convert(tmp_path_factory):
    def run(content, columns=COLUMNS, **options):
        folder = run.folder = tmp_path_factory.mktemp('csv')
        source, mapping, out = (folder / n for n in ('run.csv', 'columns.yaml', 'bag'))
        source.write_bytes(content if isinstance(content, bytes) else content.encode())
        mapping.write_text(columns)
        count, warnings = import_csv(source, load_column_map(mapping), out, **options)
        with open_bag(out) as reader:
            logged = [(time, reader.deserialize(d, c.msgtype)) for c, time, d in reader.messages()]
        found = [message for _, message in logged]
        assert [time for time, _ in logged] == stamps(found) and len(found) == count
        return warnings, found, out

    return run


def stamps(messages):
    return [to_nanoseconds(m.header.stamp) for m in messages]


@settings(max_examples=25)
@given(
    rows=ROWS, start=st.sampled_from([None, 1.0, 12.5]), unit=st.sampled_from(sorted(TIME_UNITS)),
    angle=st.sampled_from(sorted(ANGLE_UNITS)), names=st.permutations([*NAMES, 'extra']),
    delimiter=st.sampled_from(',;\t'), end=st.sampled_from(['\n', '\r\n', '\n\n']),
    outside=st.sampled_from([('', ''), ('\ufeff', '\n'), ('\ufeff', ''), ('', '\r\n')]),
    without=st.sets(st.sampled_from(NAMES[3:])), slides=st.sampled_from(['', 'm', 'mm']),
    told=st.booleans(),
)  # fmt: skip
def test_given_any_recording_when_imported_then_every_number_is_where_it_belongs(
    convert, rows, start, unit, angle, names, delimiter, end, outside, without, slides, told
):
    times = sorted(rows)
    shift = 0 if start is None else round(start * SECOND) - times[0]
    assume(times[-1] + shift < 2**31 * SECOND)
    lines, digits = [delimiter.join(f' {name} ' for name in names)], len(str(TIME_UNITS[unit])) - 1
    for time in times:
        whole, rest = divmod(time, TIME_UNITS[unit])
        texts = {'t': f'{whole}.{rest:0{digits}d}' if digits else str(whole), 'extra': 'text'}
        texts |= {n: '' if math.isnan(v) else repr(v) for n, v in zip(NAMES[1:], rows[time])}
        lines.append(delimiter.join(texts[name] for name in names))
    keep = 'keep: true' if start is None else f'start: {start}'
    columns = COLUMNS.replace('unit: s', f'unit: {unit}, {keep}') + f'angle_unit: {angle}\n'
    columns = re.sub(rf', \w+: ({"|".join(without)})\b' if without else '^$', '', columns)
    columns = columns.replace('q2', f'q2, unit: {slides}' if slides else 'q2')
    text = outside[0] + end.join(lines) + outside[1]
    warnings, messages, _ = convert(text, columns, delimiter=delimiter if told else None)
    assert (warnings, stamps(messages)) == ([], [time + shift for time in times])
    turns, slid = ANGLE_UNITS[angle], UNITS[slides or angle]
    factor = np.array([turns, slid, turns, slid, 1.0, 1.0])
    factor[[name in without for name in NAMES[1:]]] = NAN
    there = np.repeat([not without >= {*NAMES[k : k + 2]} for k in (1, 3, 5)], 2)
    for time, m in zip(times, messages):
        assert m.name == ['shoulder', 'elbow']
        values = np.concatenate([m.position, m.velocity, m.effort])
        np.testing.assert_allclose(values, (factor * rows[time])[there], rtol=1e-15)


def test_given_a_cut_off_line_or_time_that_turns_back_when_imported_then_the_rest_stays(convert):
    for end in ('', ',3.1,3.2,3.3,3.4,3.5', *(f',3,3,3,3,3,{cell}' for cell in ('-', '2e', '2e-'))):
        (warning,), messages, _ = convert(f'{HEADER}{LINES}0.006{end}')
        assert stamps(messages) == [SECOND, SECOND + 2 * MS, SECOND + 4 * MS]
        assert 'line 5' in warning
    text = ''.join(f'{t},0,0,0,0,0,0\n' for t in (5.0, 5.1, 5.1, 4.9, 5.2))
    (warning,), messages, _ = convert(HEADER + text)
    assert sorted(stamps(messages)) == [900 * MS, SECOND, 1100 * MS, 1100 * MS, 1200 * MS]
    assert 'backwards 2 times' in warning


def with_cell(index, text):
    cells = ['0.006', *'345678']
    cells[index] = text
    return HEADER + LINES + ','.join(cells) + '\n'


NO_NUMBERS = ((0, 'abc'), (1, '1.2.3'), (4, '0x10'), (6, '1 2'),
              (0, '1_0'), (2, '1_0'), (3, 'inf'), (5, '-Infinity'), (1, '1e999'))  # fmt: skip
NO_TIMES = ('', 'nan', 'inf', '-inf', '-0.001', '1e300', '1e999999999', '9e999980', '2147483648')
LATE = (HEADER + LINES * 3000).encode() + b'\xff\xfe\n' + LINES.encode()
NOTHING = ('', '\n', HEADER, b'\x80\x81\xff' * 50, bytes(100), LATE)


@pytest.mark.parametrize(('content', 'told'), [
    # In the middle, also of a file whose last line may be cut off.
    *((HEADER + '0,1,2,3\n' + lines, r'run\.csv: line 2 has too few cells')
      for lines in (LINES, LINES.rstrip())),
    (HEADER + LINES.replace('.', ','), r'line 2 has more cells than the header: decimal commas'),
    *((with_cell(k, t), rf"line 5, column '{NAMES[k]}': '{t}'") for k, t in NO_NUMBERS),
    *((with_cell(0, text), "line 5, column 't'") for text in NO_TIMES),
    *((content, r'run\.csv') for content in NOTHING),
    *((HEADER.replace(name, 'other', 1) + LINES, rf"no column '{name}'; it has .*other")
      for name in ('t', 'q2', 'u1')),
    (HEADER.replace('q2', 't') + LINES, "several columns 't'"),
])  # fmt: skip
def test_given_a_damaged_file_when_imported_then_only_an_error_comes_out(convert, content, told):
    pytest.raises(CsvError, convert, content, KEPT).match(told)
    assert not (convert.folder / 'bag').exists()


def test_given_no_file_or_an_existing_bag_when_imported_then_it_is_an_error(convert, tmp_path):
    _, _, out = convert(HEADER + LINES)
    before = {file.name: file.read_bytes() for file in out.iterdir()}
    columns, source = load_column_map(out.parent / 'columns.yaml'), out.parent / 'run.csv'
    pytest.raises(ConfigError, import_csv, source, columns, out).match('exists')
    assert {file.name: file.read_bytes() for file in out.iterdir()} == before
    wrong = [(tmp_path / 'nothing.csv', ',', 'No such file'), (tmp_path, ',', 'Is a directory')]
    wrong += [(source, delimiter, 'delimiter') for delimiter in ('', ';;', '\\t')]
    for file, delimiter, told in wrong:
        with pytest.raises(CsvError, match=rf'{file.name}: cannot be read \(.*{told}'):
            import_csv(file, columns, tmp_path / 'bag', delimiter=delimiter)
    for topic in ('', '/', 'joint_states', '/a b', '/a/', '/1'):
        with pytest.raises(CsvError, match='no full name of a topic'):
            import_csv(source, columns, tmp_path / 'bag', topic)
    assert not (tmp_path / 'bag').exists()


def test_given_a_full_disk_when_imported_then_it_is_the_bag_that_fails(convert, monkeypatch):
    def refuse(*_):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(writing._File, 'add_message', refuse)
    # It was called an error of the recording.
    with pytest.raises(ConfigError, match=r'bag: bag: cannot be written.*No space left on device'):
        convert(HEADER + LINES)
    assert not (convert.folder / 'bag').exists()


def test_given_a_map_when_loaded_then_the_shipped_one_fits_and_mistakes_are_named(tmp_path):
    columns = load_column_map(BRINGUP / 'columns' / 'real_arm.yaml')
    kinds = [f'{name}{i}' for i in (1, 2) for name in ('pos_meas', 'vel_meas', 'tau_meas')]
    assert columns.columns == ['time', *kinds] and list(columns.joints) == ['joint1', 'joint2']
    assert (columns.time_unit, columns.start, {*columns.units.values()}) == ('s', 1.0, {'rad'})
    mapping = tmp_path / 'columns.yaml'
    for old, new, field in (
        ('unit: s', 'unit: h', r'time\.unit'),
        ('unit: s', 'offset: 3', r'time\.offset'),
        *(('unit: s', start, r'time\.start') for start in ('start: 0', 'start: 5, keep: true')),
        ('unit: s', 'keep: maybe', r'time\.keep'),
        ('column: t, ', '', r'time\.column'),
        ('position: q2, ', '', r'joints\.elbow\.position'),
        ('effort: u1', 'torque: u1', r'joints\.shoulder\.torque'),
        ('effort: u1', 'unit: cm', r'joints\.shoulder\.unit'),
        ('{position: q2, velocity: w2, effort: u2}', 'q2', r'joints\.elbow'),
        ('time:', 'angle_unit: turns\ntime:', 'angle_unit'),
        ('time:', 'speed: 3\ntime:', 'speed'),
        ('joints:', 'joints: {}\nother:', 'joints'),
        ('position: q2', 'position: q1', 'joints'),
        ('velocity: w2', 'velocity: t', 'joints'),
    ):
        mapping.write_text(COLUMNS.replace(old, new, 1))
        pytest.raises(ConfigError, load_column_map, mapping).match(rf'columns\.yaml: {field}: ')


def test_given_the_command_when_run_then_it_says_what_it_wrote_or_missed(tmp_path, call, refused):
    source, mapping, out = (tmp_path / name for name in ('run.csv', 'columns.yaml', 'bag'))
    line = ['import-csv', source, '--columns', mapping, '--out', out]
    line += ['--delimiter', ';', '--topic', '/a/joint_states']
    assert refused('columns.yaml', *line)
    for columns in (HEADER, 'time: {column: t\njoints: [', COLUMNS):
        mapping.write_text(columns)
        assert refused('run.csv' if columns == COLUMNS else 'columns.yaml', *line)
    source.write_text((HEADER + LINES + '0.006,3.1').replace(',', ';'))
    printed = call(*line)
    assert printed.out.startswith('3 samples of shoulder, elbow')
    assert 'warning: line 5' in printed.err and printed.err.count('\n') == 1
    with open_bag(out) as reader:
        assert [(c.topic, c.msgcount) for c in reader.connections] == [('/a/joint_states', 3)]
