"""Monte Carlo campaigns: many runs on many machines, one table row per run (`sixthsense campaign`)."""

from sixthsense.campaign.cluster import connect, execute
from sixthsense.campaign.errors import CampaignError
from sixthsense.campaign.plan import Campaign, PlannedRun
from sixthsense.campaign.rows import Rows, load_campaign

__all__ = ["Campaign", "CampaignError", "PlannedRun", "Rows", "connect", "execute", "load_campaign"]
