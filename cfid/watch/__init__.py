"""`cfid watch` shows a run in the browser while it is recorded; its own process reads the run's folder."""
