"""Training of the denoiser of plug-and-play restoration (:mod:`cep.restoration.denoiser`)."""
