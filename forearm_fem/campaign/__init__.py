"""Many variants of one scenario: a list, a grid, or draws of the tissues; on this machine or a Dask scheduler."""

from .model import Campaign, Member, load_campaign
from .run import CampaignResult, MemberResult, run_campaign

__all__ = ["Campaign", "CampaignResult", "Member", "MemberResult", "load_campaign", "run_campaign"]
