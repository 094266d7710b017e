"""Reports of recorded runs: figures, table, one self-contained HTML file."""

from lpv_cli.report.gains_source import arm_of, find_used_gains, read_used_gains
from lpv_cli.report.table import print_table
from lpv_cli.report.write import ReportResult, write_report

__all__ = ['ReportResult', 'arm_of', 'find_used_gains', 'print_table', 'read_used_gains',
           'write_report']
