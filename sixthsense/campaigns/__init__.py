"""Monte Carlo campaigns: many runs on many machines, one table row per run (`sixthsense campaign`, `ss.campaign`)."""

from sixthsense.campaigns.call import Campaign, Execution, campaign, complete, load_campaign
from sixthsense.campaigns.cluster import connect, execute
from sixthsense.campaigns.folder import Rows
from sixthsense.campaigns.plan import CampaignPlan, PlannedRun
from sixthsense.config.errors import InputError

__all__ = [
    "Campaign",
    "CampaignPlan",
    "Execution",
    "InputError",
    "PlannedRun",
    "Rows",
    "campaign",
    "complete",
    "connect",
    "execute",
    "load_campaign",
]
