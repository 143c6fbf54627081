"""The command line: reads arguments, and turns errors into sentences and exit codes."""
