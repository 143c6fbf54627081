"""The report of a campaign, compiled from its runs, fits and parameters."""
