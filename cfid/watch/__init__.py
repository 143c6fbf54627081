"""`cfid watch`: a run in the browser while it is recorded, read from its folder by a process of its own."""
