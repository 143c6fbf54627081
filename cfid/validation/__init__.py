"""Parameter sets against a recorded flight that none of them was fitted to."""
