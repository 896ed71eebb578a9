"""Files: photos, trajectories, gyroscope recordings, MATLAB files; checks of inputs, atomic
outputs.
"""
