"""Monte Carlo campaigns: many runs on many machines, one table row per run (`sixthsense campaign`)."""

from sixthsense.campaigns.cluster import connect, execute
from sixthsense.campaigns.errors import CampaignError
from sixthsense.campaigns.plan import Campaign, PlannedRun
from sixthsense.campaigns.rows import Rows, load_campaign

__all__ = ["Campaign", "CampaignError", "PlannedRun", "Rows", "connect", "execute", "load_campaign"]
