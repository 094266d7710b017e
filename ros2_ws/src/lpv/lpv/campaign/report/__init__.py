"""One report of a campaign of runs or of bags: a page, its numbers, a summary on the terminal."""

from lpv.campaign.report.write import CampaignReport, print_summary, report_numbers, write_report

__all__ = ['CampaignReport', 'print_summary', 'report_numbers', 'write_report']
