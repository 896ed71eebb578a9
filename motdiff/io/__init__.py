"""Files: photos, trajectories, gyroscope recordings, MATLAB files; inputs that are refused, outputs written whole."""
