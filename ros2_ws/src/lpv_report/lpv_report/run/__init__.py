"""Reports of recorded runs: figures, table, one self-contained HTML file."""

from lpv_report.guarantees.gains_source import (
    arm_of,
    find_scenario,
    find_shipped_gains,
    find_used_gains,
    named_arm,
    read_used_gains,
)
from lpv_report.run.table import print_table
from lpv_report.run.write import ReportResult, write_report

__all__ = [
    'ReportResult',
    'arm_of',
    'find_scenario',
    'find_shipped_gains',
    'find_used_gains',
    'named_arm',
    'print_table',
    'read_used_gains',
    'write_report',
]
