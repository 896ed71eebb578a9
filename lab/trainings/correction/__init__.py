"""Training of the correction of searched kernels (:mod:`motdiff.network.correction`)."""
