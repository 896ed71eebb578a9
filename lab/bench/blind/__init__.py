"""Table of blind estimators on the same blurred photos, beside trivial kernels (floors) and true
ones (ceilings).
"""
