"""Monte Carlo campaigns: many runs on many machines, one table row per run (`sixthsense campaign`, `ss.campaign`)."""

from sixthsense.campaigns.call import Campaign, Execution, campaign, complete, load_campaign
from sixthsense.campaigns.folder import CampaignRows
from sixthsense.campaigns.plan import CampaignPlan, PlannedRun
from sixthsense.config.errors import InputError

__all__ = [
    "Campaign",
    "CampaignPlan",
    "CampaignRows",
    "Execution",
    "InputError",
    "PlannedRun",
    "campaign",
    "complete",
    "load_campaign",
]
