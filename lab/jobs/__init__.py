"""Jobs made of cells: cached results, executors on processes or a Dask cluster, fingerprints of
sources.
"""
