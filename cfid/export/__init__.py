"""Export a campaign's parameters to the files of firmware and simulators."""
