"""Monte Carlo campaigns: many runs on many processors, one table row per run (`sixthsense campaign`, `ss.campaign`)."""

from sixthsense.campaigns.call import Campaign as Campaign
from sixthsense.campaigns.call import complete as complete
from sixthsense.campaigns.call import load_campaign as load_campaign
from sixthsense.campaigns.folder import CampaignRows as CampaignRows
from sixthsense.campaigns.plan import CampaignPlan as CampaignPlan
