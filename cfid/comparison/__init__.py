"""Set what others published beside a campaign, quantity by quantity, or the published sets beside each other."""
