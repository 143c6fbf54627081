"""Plan and record wind runs, and reduce them to one force per command."""
