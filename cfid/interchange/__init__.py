"""Recordings of other programs into a campaign, and recordings into the files of other programs."""
