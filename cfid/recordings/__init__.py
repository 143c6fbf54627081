"""What anybody recorded: columns with units, and what fits take from them."""
