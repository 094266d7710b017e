"""Reports of recorded runs: figures, table, one self-contained HTML file."""

from lpv_cli.report.table import print_table
from lpv_cli.report.write import ReportResult, write_report

__all__ = ['ReportResult', 'print_table', 'write_report']
