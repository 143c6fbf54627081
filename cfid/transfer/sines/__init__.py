"""Plan and record sine runs, and put them on one time base."""
