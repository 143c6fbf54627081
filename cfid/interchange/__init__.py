"""Import other programs' recordings into a campaign, and convert recordings into other programs' files."""
