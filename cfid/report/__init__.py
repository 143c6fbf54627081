"""The report of a campaign, gathered from its runs, fits and parameters."""
