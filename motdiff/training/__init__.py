"""Training of MoTDiff: simulated photos, the loop, checkpoints, and its log."""
