"""MoTDiff network: a small diffusion denoiser of path maps, conditioned by a blurred photo.

Read it with Choi et al., "MoTDiff", arXiv 2510.26173:

- ``condition``: the photo's features (PVT v2, eq. 2), local emphasis and stepwise aggregation
  (eq. 3 and 4); beside them our physics maps (``physics_maps``) and their U-Net (``unet``)
- ``denoiser``: logits of x_0 from x_t, t and the condition (eq. 5); the network as a whole
- ``diffusion``: the schedule and x_t (eq. 1), losses (eq. 6 and 7), dropout of path pixels
  (eq. 8), samplers
- ``sampling``: paths drawn for photos, and their PSFs

Ours alone are ``correction``, a second network, which corrects an estimated kernel, and the
diffusion of paths in coordinates: ``path_denoiser``, and ``path_drawing``, which draws paths for
a kernel.
"""
