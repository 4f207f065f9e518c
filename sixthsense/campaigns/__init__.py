"""Monte Carlo campaigns: many runs on many processors, one table row per run (`sixthsense campaign`, `ss.campaign`)."""
