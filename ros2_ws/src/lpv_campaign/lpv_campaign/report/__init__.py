"""Report of a campaign: one self-contained page, its numbers as JSON, a summary on the terminal."""

from lpv_campaign.report.summary import print_summary
from lpv_campaign.report.write import CampaignReport, write_report

__all__ = ['CampaignReport', 'print_summary', 'write_report']
