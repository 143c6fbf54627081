"""Guide an operator through a campaign: what is found, what is missing, and the one command to type next."""
