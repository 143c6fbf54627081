"""Round trips to the vehicle, and its clock against this computer's."""
