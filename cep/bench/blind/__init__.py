"""The blind table: every estimator on the same blurred photos, beside kernels that know nothing or everything."""
