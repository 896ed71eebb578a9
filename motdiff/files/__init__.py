"""Files: photos, trajectories, gyroscope and MATLAB files; checked inputs, atomic outputs."""
