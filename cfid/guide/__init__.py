"""Guide an operator through a campaign: what was found, what is missing, and the command to type next."""
