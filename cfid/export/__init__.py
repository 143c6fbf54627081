"""Parameters of a campaign as the files that firmware and simulators take."""
