"""Monte Carlo campaigns: many runs on many machines, one table row per run (`sixthsense campaign`, `ss.campaign`)."""

from sixthsense.campaigns.call import Execution, campaign, complete
from sixthsense.campaigns.cluster import connect, execute
from sixthsense.campaigns.plan import CampaignError, CampaignPlan, PlannedRun
from sixthsense.campaigns.result import Campaign, load_campaign
from sixthsense.campaigns.rows import Rows

__all__ = [
    "Campaign",
    "CampaignError",
    "CampaignPlan",
    "Execution",
    "PlannedRun",
    "Rows",
    "campaign",
    "complete",
    "connect",
    "execute",
    "load_campaign",
]
