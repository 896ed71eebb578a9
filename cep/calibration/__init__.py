"""From photos to a motion in time: one photo, sets of coded photos, and their refinement."""
