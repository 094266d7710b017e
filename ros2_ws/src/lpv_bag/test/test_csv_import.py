"""CSV recordings as bags: exact stamps, units, missing values, damaged files."""

import math
import random
from types import SimpleNamespace

import numpy as np
import pytest
from places import BRINGUP
from rosbags.highlevel import AnyReader

from lpv_bag.run.csv_import import CsvError, import_csv, load_column_map
from lpv_bag.run.record import load_run
from lpv_cli.main import main
from lpv_core.support.errors import ConfigError

COLUMNS = """
time: {column: t, unit: s}
joints:
  shoulder: {position: q1, velocity: w1, effort: u1}
  elbow: {position: q2, velocity: w2, effort: u2}
"""
KEPT = COLUMNS.replace('unit: s', 'unit: s, keep: true')
HEADER = 't,q1,q2,w1,w2,u1,u2\n'
LINES = (
    '0.0,0.1,0.2,0.3,0.4,0.5,0.6\n0.002,1.1,1.2,1.3,1.4,1.5,1.6\n0.004,2.1,2.2,2.3,2.4,2.5,2.6\n'
)
SECOND = 1_000_000_000


def stamp(message):
    return message.header.stamp.sec * SECOND + message.header.stamp.nanosec


def read(bag):
    """Topic, log time and message of everything in a bag, as rosbags alone reads it."""
    with AnyReader([bag]) as reader:
        return [
            (c.topic, time, reader.deserialize(data, c.msgtype))
            for c, time, data in reader.messages()
        ]


@pytest.fixture
def files(tmp_path):
    """Writes a CSV file and a column map; gives the arguments of an import."""

    def write(content, columns=COLUMNS):
        source, mapping = tmp_path / 'run.csv', tmp_path / 'columns.yaml'
        source.write_bytes(content if isinstance(content, bytes) else content.encode())
        mapping.write_text(columns)
        return source, mapping, tmp_path / 'bag'

    return write


@pytest.fixture
def convert(files):
    """Imports a text and reads the bag back."""

    def run(content, columns=COLUMNS, **options):
        source, mapping, out = files(content, columns)
        count, warnings = import_csv(source, load_column_map(mapping), out, **options)
        entries = read(out)
        messages = [message for _, _, message in entries]
        return SimpleNamespace(
            count=count,
            warnings=warnings,
            messages=messages,
            out=out,
            stamps=[stamp(m) for m in messages],
            topics={t for t, _, _ in entries},
            times=[t for _, t, _ in entries],
        )

    return run


# ------------------------------------------------------------------ what is written


def test_given_a_recording_when_imported_then_every_value_is_where_it_belongs(convert):
    result = convert(HEADER + LINES)
    assert result.count == 3
    assert result.warnings == []
    assert result.topics == {'/joint_states'}
    for k, message in enumerate(result.messages):
        assert message.name == ['shoulder', 'elbow']
        assert message.position.tolist() == [float(f'{k}.1'), float(f'{k}.2')]
        assert message.velocity.tolist() == [float(f'{k}.3'), float(f'{k}.4')]
        assert message.effort.tolist() == [float(f'{k}.5'), float(f'{k}.6')]


def test_given_times_from_zero_when_imported_then_stamps_start_at_one_second(convert):
    result = convert(HEADER + LINES)
    assert result.stamps == [SECOND, SECOND + 2_000_000, SECOND + 4_000_000]
    assert result.times == result.stamps


def test_given_a_start_when_imported_then_the_first_sample_has_it_as_stamp(convert):
    columns = COLUMNS.replace('unit: s', 'unit: s, start: 12.5')
    result = convert(
        HEADER
        + LINES.replace('0.0,', '7.25,', 1).replace('0.002', '7.252').replace('0.004', '7.254'),
        columns,
    )
    assert result.stamps == [12_500_000_000, 12_502_000_000, 12_504_000_000]


def test_given_epoch_seconds_when_kept_then_stamps_are_exact_to_the_nanosecond(convert):
    rng = random.Random(3)
    stamps = sorted(rng.randrange(2**31 * SECOND) for _ in range(500))
    text = ''.join(f'{s // SECOND}.{s % SECOND:09d},0,0,0,0,0,0\n' for s in stamps)
    assert convert(HEADER + text, KEPT).stamps == stamps


def test_given_epoch_seconds_when_not_kept_then_intervals_are_exact_to_the_nanosecond(convert):
    rng = random.Random(4)
    stamps = [1_700_000_000_123_456_789 + k * 2_000_000 + rng.randrange(1000) for k in range(200)]
    text = ''.join(f'{s // SECOND}.{s % SECOND:09d},0,0,0,0,0,0\n' for s in stamps)
    assert convert(HEADER + text).stamps == [SECOND + s - stamps[0] for s in stamps]


@pytest.mark.parametrize(
    ('unit', 'factor'), [('s', SECOND), ('ms', 1_000_000), ('us', 1000), ('ns', 1)]
)
def test_given_a_unit_of_time_when_imported_then_stamps_are_in_nanoseconds(convert, unit, factor):
    columns = KEPT.replace('unit: s', f'unit: {unit}')
    result = convert(HEADER + '3,0,0,0,0,0,0\n4.5e1,0,0,0,0,0,0\n', columns)
    assert result.stamps == [3 * factor, 45 * factor]


def test_given_degrees_when_imported_then_positions_and_rates_are_converted_and_efforts_not(
    convert,
):
    result = convert(HEADER + '0,180,-90,45,360,2,3\n', COLUMNS + 'angle_unit: deg\n')
    message = result.messages[0]
    np.testing.assert_allclose(message.position, [math.pi, -math.pi / 2], rtol=1e-15)
    np.testing.assert_allclose(message.velocity, [math.pi / 4, 2 * math.pi], rtol=1e-15)
    assert message.effort.tolist() == [2.0, 3.0]


def test_given_no_effort_columns_when_imported_then_messages_carry_no_effort(convert):
    columns = COLUMNS.replace(', effort: u1', '').replace(', effort: u2', '')
    result = convert('t,q1,q2,w1,w2\n0,1,2,3,4\n', columns)
    assert result.messages[0].effort.tolist() == []
    assert result.messages[0].velocity.tolist() == [3.0, 4.0]


def test_given_the_effort_of_one_joint_only_when_imported_then_the_other_is_not_a_number(convert):
    result = convert('t,q1,q2,w1,w2,u2\n0,1,2,3,4,5\n', COLUMNS.replace(', effort: u1', ''))
    np.testing.assert_array_equal(result.messages[0].effort, [math.nan, 5.0])


def test_given_empty_cells_when_imported_then_they_are_not_numbers_and_nothing_is_left_out(convert):
    result = convert(HEADER + '0,,2,3,4,5,6\n1,1,2, ,4,5,\n')
    assert result.count == 2
    assert result.warnings == []
    np.testing.assert_array_equal(result.messages[0].position, [math.nan, 2.0])
    np.testing.assert_array_equal(result.messages[1].velocity, [math.nan, 4.0])
    np.testing.assert_array_equal(result.messages[1].effort, [5.0, math.nan])


def test_given_columns_in_another_order_and_more_of_them_when_imported_then_names_decide(convert):
    result = convert('u2,extra,w2,q2, t ,q1,w1,u1\n6,text,4,2,0,1,3,5\n')
    message = result.messages[0]
    values = np.concatenate([message.position, message.velocity, message.effort])
    assert values.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


@pytest.mark.parametrize(
    'change',
    [
        lambda text: '\ufeff' + text,
        lambda text: text.replace('\n', '\r\n'),
        lambda text: text.rstrip('\n'),
        lambda text: text.replace('\n', '\n\n'),
        lambda text: text.replace(',', ' , '),
    ],
    ids=['byte order mark', 'crlf', 'no last newline', 'empty lines', 'spaces'],
)
def test_given_a_file_as_other_programs_write_it_when_imported_then_nothing_changes(
    convert, change
):
    result = convert(change(HEADER + LINES))
    assert result.warnings == []
    assert result.stamps == [SECOND, SECOND + 2_000_000, SECOND + 4_000_000]
    assert [m.position[0] for m in result.messages] == [0.1, 1.1, 2.1]
    assert [m.effort[1] for m in result.messages] == [0.6, 1.6, 2.6]


@pytest.mark.parametrize('delimiter', [';', '\t', ' '])
def test_given_a_delimiter_when_imported_then_cells_are_told_apart(convert, delimiter):
    result = convert((HEADER + LINES).replace(',', delimiter), delimiter=delimiter)
    assert [m.position[1] for m in result.messages] == [0.2, 1.2, 2.2]


def test_given_an_imported_bag_when_loaded_as_a_run_then_it_is_complete(convert):
    record = load_run(convert(HEADER + LINES).out)
    assert record.joint_names == ('shoulder', 'elbow')
    assert record.time.tolist() == [0.0, 0.002, 0.004]
    assert record.get('joint_states', 'effort').tolist() == [[0.5, 0.6], [1.5, 1.6], [2.5, 2.6]]


# ------------------------------------------------------------------ files that are damaged


@pytest.mark.parametrize('last', ['0.006', '0.006,3.1,3.2,3.3,3.4', '0.006,3.1,3.2,3.3,3.4,3.5'])
def test_given_a_last_line_that_is_cut_off_when_imported_then_all_others_are_kept(convert, last):
    result = convert(HEADER + LINES + last)
    assert result.count == 3
    assert result.stamps[-1] == SECOND + 4_000_000
    assert len(result.warnings) == 1
    assert 'line 5' in result.warnings[0]


@pytest.mark.parametrize('cell', ['-', '2.6e', '2.6e-'])
def test_given_a_last_cell_that_is_cut_off_when_imported_then_all_other_lines_are_kept(
    convert, cell
):
    result = convert(HEADER + LINES + '0.006,3.1,3.2,3.3,3.4,3.5,' + cell)
    assert result.count == 3
    assert 'line 5' in result.warnings[0]


def test_given_a_short_line_in_the_middle_when_imported_then_its_number_is_named(files):
    source, mapping, out = files(HEADER + '0,1,2,3\n' + LINES)
    with pytest.raises(CsvError, match=r'run\.csv: line 2 has too few cells'):
        import_csv(source, load_column_map(mapping), out)


@pytest.mark.parametrize('name', ['t', 'q2', 'u1'])
def test_given_a_missing_column_when_imported_then_it_is_named_with_those_there(files, name):
    source, mapping, out = files((HEADER + LINES).replace(name + ',', 'other,', 1))
    with pytest.raises(CsvError, match=rf"no column '{name}'; it has .*other"):
        import_csv(source, load_column_map(mapping), out)
    assert not out.exists()


@pytest.mark.parametrize(('column', 'index'), [('t', 0), ('q1', 1), ('w2', 4), ('u2', 6)])
@pytest.mark.parametrize('text', ['abc', '1.2.3', '0x10', '1 2'])
def test_given_a_cell_that_is_no_number_when_imported_then_line_and_column_are_named(
    files, column, index, text
):
    cells = ['0.006', '3.1', '3.2', '3.3', '3.4', '3.5', '3.6']
    cells[index] = text
    source, mapping, out = files(HEADER + LINES + ','.join(cells) + '\n')
    with pytest.raises(CsvError, match=rf"line 5, column '{column}': '{text}'"):
        import_csv(source, load_column_map(mapping), out)


@pytest.mark.parametrize('text', ['', 'nan', 'inf', '-inf', '-0.001', '1e300', '2147483648'])
def test_given_a_time_that_is_no_stamp_when_imported_then_line_and_column_are_named(files, text):
    source, mapping, out = files(HEADER + LINES + text + ',1,2,3,4,5,6\n', KEPT)
    with pytest.raises(CsvError, match="line 5, column 't'"):
        import_csv(source, load_column_map(mapping), out)


def test_given_time_that_runs_backwards_when_imported_then_all_is_kept_with_a_warning(convert):
    text = ''.join(f'{t},0,0,0,0,0,0\n' for t in (5.0, 5.1, 5.1, 4.9, 5.2))
    result = convert(HEADER + text)
    assert result.count == 5
    assert sorted(result.stamps) == [
        900_000_000,
        SECOND,
        1_100_000_000,
        1_100_000_000,
        1_200_000_000,
    ]
    assert len(result.warnings) == 1
    assert 'backwards 2 times' in result.warnings[0]


@pytest.mark.parametrize(
    'content',
    ['', '\n', HEADER, b'\x80\x81\xff' * 50, b'\x00' * 100],
    ids=['empty', 'newline', 'header', 'binary', 'zeros'],
)
def test_given_a_file_without_samples_when_imported_then_the_error_names_it(files, content):
    source, mapping, out = files(content)
    with pytest.raises(CsvError, match=r'run\.csv'):
        import_csv(source, load_column_map(mapping), out)


def test_given_bytes_that_are_no_text_in_the_middle_when_imported_then_the_error_names_the_file(
    files,
):
    line = b'0,1,2,3,4,5,6\n'
    source, mapping, out = files(HEADER.encode() + line * 3000 + b'\xff\xfe\n' + line)
    with pytest.raises(CsvError, match=r'run\.csv'):
        import_csv(source, load_column_map(mapping), out)


def test_given_no_file_when_imported_then_the_error_names_it(files, tmp_path):
    _, mapping, out = files('')
    for source in (tmp_path / 'nothing.csv', tmp_path):
        with pytest.raises(CsvError, match=source.name):
            import_csv(source, load_column_map(mapping), out)
    assert not out.exists()


@pytest.mark.parametrize('delimiter', ['', ';;', '\\t'])
def test_given_a_delimiter_of_another_length_than_one_when_imported_then_it_is_an_error(
    files, delimiter
):
    source, mapping, out = files(HEADER + LINES)
    with pytest.raises(CsvError):
        import_csv(source, load_column_map(mapping), out, delimiter=delimiter)


def test_given_an_existing_bag_when_imported_then_it_is_an_error_and_the_bag_stays(convert):
    first = convert(HEADER + LINES)
    before = {file.name: file.read_bytes() for file in first.out.iterdir()}
    with pytest.raises(ConfigError, match='exists'):
        convert(HEADER + LINES)
    assert {file.name: file.read_bytes() for file in first.out.iterdir()} == before


@pytest.mark.parametrize('bad', ['1,x,2,3,4,5,6\n', ''])
def test_given_an_error_in_the_file_when_imported_then_no_bag_is_left(files, bad):
    source, mapping, out = files(HEADER + (LINES + bad if bad else ''))
    with pytest.raises(CsvError):
        import_csv(source, load_column_map(mapping), out)
    assert not out.exists()


# ------------------------------------------------------------------ column maps


def test_given_the_shipped_map_when_loaded_then_it_fits_the_recordings():
    columns = load_column_map(BRINGUP / 'columns' / 'real_arm.yaml')
    assert columns.columns == [
        'time',
        'pos_meas1',
        'vel_meas1',
        'tau_meas1',
        'pos_meas2',
        'vel_meas2',
        'tau_meas2',
    ]
    assert list(columns.joints) == ['joint1', 'joint2']
    assert (columns.time_unit, columns.start, columns.angle_unit) == ('s', 1.0, 'rad')


@pytest.mark.parametrize(
    ('old', 'new', 'field'),
    [
        ('unit: s', 'unit: h', r'time\.unit'),
        ('unit: s', 'unit: s, offset: 3', r'time\.offset'),
        ('unit: s', 'unit: s, start: 0', r'time\.start'),
        ('unit: s', 'unit: s, start: 5, keep: true', r'time\.start'),
        ('unit: s', 'unit: s, keep: maybe', r'time\.keep'),
        ('column: t, ', '', r'time\.column'),
        ('position: q2, ', '', r'joints\.elbow\.position'),
        ('effort: u1', 'torque: u1', r'joints\.shoulder\.torque'),
        ('{position: q2, velocity: w2, effort: u2}', 'q2', r'joints\.elbow'),
        ('time:', 'angle_unit: turns\ntime:', 'angle_unit'),
        ('time:', 'speed: 3\ntime:', 'speed'),
        ('joints:', 'joints: {}\nother:', 'joints'),
    ],
)
def test_given_a_map_with_a_mistake_when_loaded_then_the_field_is_named(files, old, new, field):
    _, mapping, _ = files('', COLUMNS.replace(old, new, 1))
    with pytest.raises(ConfigError, match=rf'columns\.yaml: {field}: '):
        load_column_map(mapping)


# ------------------------------------------------------------------ command line


def test_given_the_command_when_run_then_it_says_how_many_samples_of_which_joints(files, capsys):
    source, mapping, out = files((HEADER + LINES + '0.006,3.1').replace(',', ';'))
    assert (
        main(
            [
                'import-csv',
                str(source),
                '--columns',
                str(mapping),
                '--out',
                str(out),
                '--delimiter',
                ';',
                '--topic',
                '/a/joint_states',
            ]
        )
        == 0
    )
    said = capsys.readouterr()
    assert said.out.startswith('3 samples of shoulder, elbow')
    assert said.err.count('\n') == 1
    assert 'warning: line 5' in said.err
    assert [topic for topic, _, _ in read(out)] == ['/a/joint_states'] * 3


@pytest.mark.parametrize(
    'change',
    [
        {'source': 'nothing.csv'},
        {'columns': 'nothing.yaml'},
        {'columns': 'run.csv'},
        {'text': 'a,b\n1,2\n'},
        {'text': HEADER + '0,x,2,3,4,5,6\n'},
    ],
    ids=['no file', 'no map', 'map is no map', 'columns', 'cell'],
)
def test_given_bad_input_when_the_command_is_run_then_one_line_says_so_and_the_code_is_2(
    files, tmp_path, capsys, change
):
    source, mapping, out = files(change.get('text', HEADER + LINES))
    source = tmp_path / change.get('source', source.name)
    mapping = tmp_path / change.get('columns', mapping.name)
    assert main(['import-csv', str(source), '--columns', str(mapping), '--out', str(out)]) == 2
    said = capsys.readouterr()
    assert said.out == ''
    assert said.err.startswith('lpv import-csv: ')
    assert said.err.count('\n') == 1


def test_given_a_map_that_is_not_yaml_when_the_command_is_run_then_one_line_says_so(files, capsys):
    source, mapping, out = files(HEADER + LINES, 'time: {column: t\njoints: [')
    assert main(['import-csv', str(source), '--columns', str(mapping), '--out', str(out)]) == 2
    assert capsys.readouterr().err.count('\n') == 1
