"""Training of MoTDiff: simulated photos, the loop, checkpoints, and its log.

A run, in the order of its data:

- ``config``: the run's TOML file
- ``photos``, ``motion_bank``: sharp photos, random motions as tensors
- ``simulation``, ``samples``: photos of these motions, and the classical kernels found in them
- ``prepared``: samples stored ahead, in shards; ``batches``: those of the network's inputs
- ``trainer``: updates; ``run_piece``: a piece of a run, with ``log`` and ``checkpoint``
- ``weight_files``: the weights that a run starts from, and those that it exports
"""
