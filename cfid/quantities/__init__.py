"""The registry of quantities: key, unit, shape, symbol, title, producing command and plausible range of each."""
